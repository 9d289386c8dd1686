//! The verifier finds every fault that is put into a good plan.

use forelight_planner::{
    Bound, Confidence, Division, FixedBooking, Frame, Input, Interval, Job, Node, Plan, Task, Verdict,
    Violation, WorkTotal, plan, verify,
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

/// Two frames of 60 units of work, in two or three parts, on two nodes.
fn divided() -> Input {
    let mut input = input();
    input.fixed.clear();
    let job = &mut input.jobs[0];
    job.frames.truncate(2);
    job.part_overhead = 5;
    for frame in &mut job.frames {
        (frame.work, frame.division) = (60, Division::Into(2 + frame.number as u32));
    }
    job.total = WorkTotal { p50: 120, p80: 120, p95: 120 };
    input.jobs.truncate(1);
    input
}

/// The violations of a good plan with divided frames after tampering.
fn faults_of_parts(tamper: impl FnOnce(&mut Input, &mut Plan)) -> Vec<Violation> {
    let mut input = divided();
    let mut plan = plan(&input).expect("a plan");
    assert_eq!(verify(&input, &plan), Ok(()));
    assert_eq!(plan.bookings.len(), 5, "two and three parts");
    tamper(&mut input, &mut plan);
    verify(&input, &plan).expect_err("a fault")
}

/// The place of a part of the second frame, which has three.
fn part_of_second(plan: &Plan, part: u32) -> usize {
    let task = Task::Part { frame: 1, part, parts: 3 };
    plan.bookings.iter().position(|booking| booking.task == task).expect("a booking of the part")
}

#[test]
fn a_part_that_is_missing_is_found() {
    for part in 0..3 {
        let found = faults_of_parts(|_, p| {
            p.bookings.remove(part_of_second(p, part));
        });
        let task = Task::Part { frame: 1, part, parts: 3 };
        assert!(found.contains(&Violation::Missing { job: 1, task }), "{found:?}");
    }
}

#[test]
fn a_part_that_is_booked_twice_is_found() {
    for (part, other) in [(0, 1), (2, 0)] {
        let found = faults_of_parts(|_, p| {
            let index = part_of_second(p, part);
            p.bookings[index].task = Task::Part { frame: 1, part: other, parts: 3 };
        });
        let twice = Task::Part { frame: 1, part: other, parts: 3 };
        assert!(found.contains(&Violation::Twice { job: 1, task: twice }), "{found:?}");
        let missing = Task::Part { frame: 1, part, parts: 3 };
        assert!(found.contains(&Violation::Missing { job: 1, task: missing }), "{found:?}");
    }
}

#[test]
fn a_number_of_parts_that_the_frame_may_not_have_is_found() {
    let is_division = |v: &Violation| matches!(v, Violation::Division(_));
    for allowed in
        [Division::Whole, Division::UpTo(2), Division::Into(2), Division::Into(4), Division::UpTo(0)]
    {
        let found = faults_of_parts(|input, _| input.jobs[0].frames[1].division = allowed);
        assert_eq!(found.iter().filter(|v| is_division(v)).count(), 3, "{allowed:?}: {found:?}");
    }
    // One part of another division among the others, and parts beyond the last.
    for task in [
        Task::Part { frame: 1, part: 0, parts: 2 },
        Task::Part { frame: 1, part: 3, parts: 3 },
        Task::Part { frame: 1, part: 0, parts: 0 },
        Task::Part { frame: 1, part: u32::MAX, parts: u32::MAX },
        Task::Frame(1),
    ] {
        let found = faults_of_parts(|_, p| {
            let index = part_of_second(p, 1);
            p.bookings[index].task = task;
        });
        assert!(found.iter().any(is_division), "{task}: {found:?}");
    }
}

#[test]
fn a_whole_frame_that_must_be_divided_and_a_single_part_are_found() {
    for task in [Task::Frame(1), Task::Part { frame: 1, part: 0, parts: 1 }] {
        let found = faults_of_parts(|_, p| {
            p.bookings.retain(|booking| booking.task.frame() == Some(0));
            let (start, end) = (300, 360);
            p.bookings.push(forelight_planner::Booking { start, node: 1, job: 1, task, end });
        });
        assert!(found.iter().any(|v| matches!(v, Violation::Division(_))), "{found:?}");
    }
}

#[test]
fn a_part_without_its_overhead_is_too_short() {
    let found = faults_of_parts(|_, p| {
        let index = part_of_second(p, 2);
        p.bookings[index].end -= 5;
    });
    assert!(found.iter().any(|v| matches!(v, Violation::Duration(_))), "{found:?}");
}

#[test]
fn a_divided_frame_called_unplaced_is_found() {
    let found = faults_of_parts(|_, p| {
        p.jobs[0].verdict = Verdict::Unplaced { frames: vec![1], shared_cache: false };
    });
    assert!(found.contains(&Violation::Twice { job: 1, task: Task::Frame(1) }), "{found:?}");
}
