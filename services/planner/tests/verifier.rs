//! The verifier finds every fault that is put into a good plan.

use forelight_planner::{
    Bound, Confidence, FixedBooking, Frame, Input, Interval, Job, Node, Plan, Task, Verdict, Violation,
    WorkTotal, plan, verify,
};

fn input() -> Input {
    let node = |id| Node {
        id,
        name: String::new(),
        speed: 1_000_000,
        price_per_hour: 3_600_000_000,
        available_from: 10,
        calendar: vec![Interval { start: 0, end: Some(60) }, Interval { start: 60, end: Some(500) }],
        ..Node::default()
    };
    let job = |id, release, deadline, works: &[u64]| Job {
        id,
        release,
        deadline,
        confidence: Confidence::P80,
        total: WorkTotal { p50: 0, p80: works.iter().sum(), p95: u64::MAX },
        frames: (0..).zip(works).map(|(number, &work)| Frame { number, work, ..Frame::default() }).collect(),
        budget: Some(1000),
        ..Job::default()
    };
    Input {
        nodes: vec![node(1), node(2)],
        fixed: vec![FixedBooking { node: 1, start: 200, end: 210, ..FixedBooking::default() }],
        jobs: vec![job(1, 0, Some(300), &[40, 30, 20]), job(2, 50, None, &[25, 600])],
        ..Input::default()
    }
}

/// The violations of a good plan after tampering.
fn faults(tamper: impl FnOnce(&mut Plan)) -> Vec<Violation> {
    let input = input();
    let mut plan = plan(&input).expect("a plan");
    assert_eq!(verify(&input, &plan), Ok(()));
    tamper(&mut plan);
    verify(&input, &plan).expect_err("a fault")
}

fn shift(plan: &mut Plan, index: usize, by: i64) {
    plan.bookings[index].start += by;
    plan.bookings[index].end += by;
}

#[test]
fn a_booking_outside_the_calendar_is_found() {
    assert!(faults(|p| shift(p, 0, 480)).iter().any(|v| matches!(v, Violation::Calendar(_))));
    assert!(faults(|p| shift(p, 0, -1)).iter().any(|v| matches!(v, Violation::Calendar(_))));
}

#[test]
fn an_interval_that_continues_another_is_no_gap() {
    // The bookings across instant 60, in the plan that `faults` starts from.
    let plan = plan(&input()).expect("a plan");
    assert!(plan.bookings.iter().any(|b| b.start < 60 && b.end > 60));
}

#[test]
fn overlaps_are_found_with_each_other_and_with_fixed_bookings() {
    let last = plan(&input()).expect("a plan").bookings.len() - 1;
    assert!(faults(|p| shift(p, last, -1)).iter().any(|v| matches!(v, Violation::Overlap(_))));
    let on_fixed = faults(|p| {
        p.bookings[0].node = 1;
        shift(p, 0, 199);
    });
    assert!(on_fixed.iter().any(|v| matches!(v, Violation::Overlap(_))));
}

#[test]
fn a_wrong_duration_is_found() {
    assert!(faults(|p| p.bookings[0].end += 1).iter().any(|v| matches!(v, Violation::Duration(_))));
    assert!(faults(|p| p.bookings[0].end -= 1).iter().any(|v| matches!(v, Violation::Duration(_))));
}

#[test]
fn a_start_before_the_release_is_found() {
    let found = faults(|p| {
        let booking = p.bookings.iter_mut().find(|b| b.job == 2).expect("job 2 has a booking");
        (booking.start, booking.end) = (49, 74);
    });
    assert!(found.iter().any(|v| matches!(v, Violation::Release(_))));
}

#[test]
fn missing_double_and_unknown_frames_are_found() {
    let missing = faults(|p| p.bookings.truncate(p.bookings.len() - 1));
    assert!(missing.iter().any(|v| matches!(v, Violation::Missing { .. })));
    let twice = faults(|p| {
        p.bookings.push(p.bookings[0]);
        let last = p.bookings.len() - 1;
        shift(p, last, 300);
    });
    assert!(twice.iter().any(|v| matches!(v, Violation::Twice { .. })));
    for unknown in [
        faults(|p| p.bookings[0].task = Task::Frame(77)),
        faults(|p| p.bookings[0].job = 77),
        faults(|p| p.bookings[0].node = 77),
    ] {
        assert!(unknown.iter().any(|v| matches!(v, Violation::Unknown(_))));
    }
}

#[test]
fn wrong_words_about_a_job_are_found() {
    let verdict = |v: &Violation| matches!(v, Violation::Verdict { .. });
    assert!(faults(|p| p.jobs[0].verdict = Verdict::NoDeadline { finish: 60 }).iter().any(verdict));
    let Verdict::Feasible { finish, slack } = plan(&input()).expect("a plan").jobs[0].verdict else {
        panic!("job 1 is in time")
    };
    for wrong in [
        Verdict::Feasible { finish: finish - 1, slack: slack + 1 },
        Verdict::Feasible { finish, slack: slack + 1 },
        Verdict::Late { finish, by: 1, unavoidable: false },
    ] {
        assert!(faults(|p| p.jobs[0].verdict = wrong).iter().any(verdict));
    }
    assert!(faults(|p| p.jobs[0].cost -= 1).iter().any(|v| matches!(v, Violation::Cost { job: 1, .. })));
    assert!(faults(|p| p.jobs[0].within_budget = None).iter().any(|v| matches!(v, Violation::Cost { .. })));
    assert!(faults(|p| p.cost += 1).iter().any(|v| matches!(v, Violation::TotalCost { .. })));
    assert!(faults(|p| p.jobs.truncate(1)).iter().any(|v| matches!(v, Violation::Verdicts { job: 2, .. })));
    assert!(faults(|p| p.jobs[0].job = 9).iter().any(|v| matches!(v, Violation::UnknownJob { job: 9 })));
}

#[test]
fn frames_wrongly_called_unplaced_are_found() {
    let booked =
        faults(|p| p.jobs[1].verdict = Verdict::Unplaced { frames: vec![0, 1], shared_cache: false });
    assert!(booked.iter().any(|v| matches!(v, Violation::Twice { job: 2, task: Task::Frame(0) })));
    let unknown =
        faults(|p| p.jobs[1].verdict = Verdict::Unplaced { frames: vec![1, 5], shared_cache: false });
    assert!(unknown.iter().any(|v| matches!(v, Violation::UnknownUnplaced { job: 2, task: Task::Frame(5) })));
}

#[test]
fn a_bound_after_the_end_is_found() {
    let late = Bound { by_capacity: Some(499), by_longest_frame: Some(0) };
    assert!(
        faults(|p| p.jobs[0].bound = late).iter().any(|v| matches!(v, Violation::Bound { job: Some(1) }))
    );
    assert!(
        faults(|p| p.jobs[0].bound = Bound::default())
            .iter()
            .any(|v| matches!(v, Violation::Bound { job: Some(1) }))
    );
}
