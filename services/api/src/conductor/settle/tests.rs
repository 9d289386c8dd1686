//! Plans of farms whose answers can be worked out by hand.

use super::*;
use crate::conductor::made_up::{at, booking, farm_job, job_id, node, snapshot, waiting};
use forelight_planner::Task;

fn bookings<const N: usize>(all: [(u64, u64, i64, i64); N]) -> Vec<Booking> {
    let one = |(frame, (job, node, start, end))| Booking { start, node, job, task: Task::Frame(frame), end };
    (0..).zip(all).map(one).collect()
}

#[test]
fn a_job_that_a_budget_holds_keeps_its_place_only_until_another_needs_it() {
    const HOUR: i64 = 3600;
    let nodes = || vec![node(1, 1_000_000, 1000, serde_json::Value::Null)];
    let (held, new) = (job_id(1), job_id(2));
    let open: Vec<_> = (0..4)
        .map(|frame| waiting(booking(held, frame, 1, (HOUR * i64::from(frame), HOUR * i64::from(frame + 1)))))
        .collect();
    let settled = |is_held: bool, with_new: bool| {
        let mut promised = farm_job(held, &open);
        promised.held = is_held;
        promised.job.deadline = Some(at(4 * HOUR));
        let said = |verdict| JobVerdict {
            job_id: held,
            verdict,
            confidence: promised.job.confidence,
            finish: None,
            cost: None,
            reasons: Vec::new(),
            ways_out: Vec::new(),
        };
        promised.job.verdict = Some(said(Verdict::OnTime));
        let mut urgent = farm_job(new, &[waiting(booking(new, 0, 1, (0, HOUR)))]);
        (urgent.job.deadline, urgent.job.plan_id) = (Some(at(2 * HOUR)), None);
        let jobs = if with_new { vec![promised, urgent] } else { vec![promised] };
        let farm = Farm::new(&snapshot(nodes(), jobs, &open, &[]));
        let fresh = with_new.then(|| farm.place(new).unwrap());
        settle(&farm, fresh).unwrap()
    };
    let verdicts = |settled: &Settled| -> Vec<(JobId, Verdict)> {
        settled.jobs.iter().map(|job| (job.verdict.job_id, job.verdict.verdict)).collect()
    };
    assert_eq!(verdicts(&settled(false, true)), [(new, Verdict::Late)], "the promise stands");
    let found = settled(true, true);
    assert_eq!(verdicts(&found), [(held, Verdict::Late), (new, Verdict::OnTime)]);
    assert!(found.jobs[0].verdict.reasons.iter().any(|reason| reason.contains("budget of project film")));
    assert_eq!(found.jobs[0].bookings.len(), 4, "it is booked behind the other");
    let (_, outlook) = &found.outlooks[0];
    assert!(outlook.waits.as_ref().is_some_and(forelight_protocol::Waits::is_held), "{outlook:?}");
    assert!(outlook.promise.as_ref().is_some_and(|promise| !promise.kept), "{outlook:?}");
    assert!(verdicts(&settled(true, false)).is_empty(), "nobody needs its place");
}

#[test]
fn a_job_is_booked_anew_when_its_frames_keep_their_node_longer() {
    const HOUR: i64 = 3600;
    let open: Vec<_> = (0..2)
        .map(|frame| {
            waiting(booking(job_id(1), frame, 1, (HOUR * i64::from(frame), HOUR * i64::from(frame + 1))))
        })
        .collect();
    let booked_for = |minutes: i64| {
        let mut job = farm_job(job_id(1), &open);
        job.serial_time.one_core = minutes * 60_000_000;
        job.job.verdict = None;
        let mut snapshot = snapshot(vec![node(1, 0, 1000, serde_json::Value::Null)], vec![job], &open, &[]);
        let first = settle(&Farm::new(&snapshot), None).unwrap();
        // Its verdict is known, so that only the time is news.
        snapshot.jobs[0].job.verdict = Some(first.jobs[0].verdict.clone());
        let settled = settle(&Farm::new(&snapshot), None).unwrap();
        let lengths = settled.jobs.iter().flat_map(|job| &job.bookings);
        lengths.map(|booking| booking.end.micros_since(booking.start) / 60_000_000).collect::<Vec<_>>()
    };
    assert!(booked_for(0).is_empty(), "nothing is news");
    assert!(booked_for(5).is_empty(), "less than a tenth");
    assert_eq!(booked_for(32), [60 + 31, 60 + 31], "to four bits");
}

#[test]
fn who_lies_where_another_is_booked_now_is_booked_anew_and_so_on() {
    // Job 3 is new at 0. Job 0 makes way for it, and job 1 for job 0. Job 2 has its own node.
    let booked = bookings([(0, 0, 0, 10), (1, 0, 10, 20), (2, 1, 0, 20)]);
    let planned = bookings([(3, 0, 0, 10), (0, 0, 10, 20), (1, 0, 20, 30), (2, 1, 0, 20)]);
    let anew = make_way(&booked, &planned, vec![false, false, false, true]);
    assert_eq!(anew, [true, true, false, true]);
    let planned = bookings([(3, 0, 20, 30), (0, 0, 1, 11), (1, 0, 11, 20), (2, 1, 0, 20)]);
    assert_eq!(make_way(&booked, &planned, vec![false, false, false, true]), [false, false, false, true]);
}

#[test]
fn what_finds_no_place_is_named_frames_or_the_shared_cache() {
    let open = [waiting(booking(job_id(1), 0, 1, (0, 3600)))];
    let nodes = vec![node(1, 0, 1000, serde_json::Value::Null)];
    let farm = Farm::new(&snapshot(nodes, vec![farm_job(job_id(1), &open)], &open, &[]));
    let said = |frames: i64, shared_cache| {
        let entry = planner::JobPlan {
            job: 0,
            verdict: planner::Verdict::Unplaced { frames: (0..frames).collect(), shared_cache },
            cost: 0,
            within_budget: None,
            bound: planner::Bound::default(),
        };
        unplaced(&farm, None, Some(&entry))
    };
    assert_eq!(said(1, false), "1 frame does not fit into any node's free time");
    assert_eq!(said(2, false), "2 frames do not fit into any node's free time");
    assert_eq!(said(0, true), "its shared cache does not fit into any node's free time");
}

#[test]
fn a_job_that_is_late_in_every_plan_is_told_what_one_node_could_do() {
    let open = [waiting(booking(job_id(1), 0, 1, (0, 3600)))];
    let mut late = farm_job(job_id(1), &open);
    late.job.deadline = Some(at(1800));
    late.has_new_terms = true;
    let nodes = vec![node(1, 0, 1000, serde_json::Value::Null)];
    let found = settle(&Farm::new(&snapshot(nodes, vec![late], &open, &[])), None).unwrap();
    let reasons = &found.jobs[0].verdict.reasons;
    assert_eq!(reasons[0], "30 min after the deadline");
    assert!(reasons[1].contains("with the only node to itself"), "{reasons:?}");
}
