//! Divided frames, on farms with known answers.

use forelight_planner::{
    Booking, Change, Confidence, Division, Event, Frame, Input, InputError, Interval, Job, Node, Plan, Task,
    Verdict, WorkTotal, plan, replan, verify, ways_out,
};
use proptest::prelude::*;

const HOUR: i64 = 3_600_000_000;
const MINUTE: i64 = HOUR / 60;

/// One unit of work is a second at speed one.
fn node(id: u64, speed: u64, price: i64) -> Node {
    let calendar = vec![Interval { start: 0, end: None }];
    Node { id, speed, price_per_hour: price, calendar, ..Node::default() }
}

/// Frames of so many seconds at speed one, divided alike. A part costs six seconds on top.
fn job(id: u64, deadline: Option<i64>, division: Division, seconds: &[u64]) -> Job {
    let total = seconds.iter().sum();
    let frame = |(number, &work)| Frame { number, work, division, ..Frame::default() };
    Job {
        id,
        deadline,
        confidence: Confidence::P50,
        total: WorkTotal { p50: total, p80: total, p95: total },
        frames: (0..).zip(seconds).map(frame).collect(),
        part_overhead: 6,
        ..Job::default()
    }
}

fn farm(nodes: impl IntoIterator<Item = Node>, jobs: Vec<Job>) -> Input {
    Input { nodes: nodes.into_iter().collect(), jobs, ..Input::default() }
}

fn equal(count: u64) -> impl Iterator<Item = Node> {
    (0..count).map(|id| node(id, 1, 1_000_000))
}

fn sound(input: &Input) -> Plan {
    let found = plan(input).expect("a plan");
    assert_eq!(verify(input, &found), Ok(()));
    found
}

fn parts_of(plan: &Plan, job: u64, frame: i64) -> Vec<Booking> {
    let is_of = |booking: &&Booking| booking.job == job && booking.task.frame() == Some(frame);
    plan.bookings.iter().filter(is_of).copied().collect()
}

#[test]
fn a_frame_that_must_have_parts_has_exactly_as_many() {
    for deadline in [None, Some(HOUR), Some(HOUR / 100)] {
        let found = sound(&farm(equal(4), vec![job(1, deadline, Division::Into(5), &[600, 600])]));
        for frame in 0..2 {
            let parts = parts_of(&found, 1, frame);
            assert_eq!(parts.len(), 5, "{deadline:?}");
            assert!(
                parts.iter().all(|part| part.end - part.start == 126_000_000),
                "a fifth, and six seconds"
            );
        }
    }
}

#[test]
fn a_frame_has_the_fewest_parts_that_end_by_its_deadline() {
    let parts = |deadline: i64, most: u32| {
        let found = sound(&farm(equal(9), vec![job(1, Some(deadline), Division::UpTo(most), &[3600])]));
        (parts_of(&found, 1, 0).len(), found.jobs[0].verdict.is_kept())
    };
    assert_eq!(parts(HOUR, 9), (1, true), "it fits whole");
    assert_eq!(parts(HOUR - 1, 9), (2, true));
    assert_eq!(parts(30 * MINUTE + 6_000_000, 9), (2, true));
    assert_eq!(parts(30 * MINUTE, 9), (3, true), "half of it is too long with the overhead");
    assert_eq!(parts(406_000_000, 9), (9, true));
    assert!(!parts(405_000_000, 9).1 && !parts(406_000_000, 8).1);
}

#[test]
fn a_frame_that_is_longer_than_every_window_is_divided() {
    let windows = |node: Node| Node {
        calendar: (0..40)
            .map(|day| Interval { start: day * 2 * HOUR, end: Some((day * 2 + 1) * HOUR) })
            .collect(),
        ..node
    };
    for deadline in [None, Some(80 * HOUR)] {
        let jobs = vec![job(1, deadline, Division::UpTo(64), &[5 * 3600])];
        let found = sound(&farm(equal(2).map(windows), jobs));
        assert!(found.jobs[0].verdict.is_kept() && parts_of(&found, 1, 0).len() > 5, "{found:?}");
    }
}

#[test]
fn a_still_ends_as_early_as_three_per_cent_pay_for() {
    let ends = |most: u32, nodes: u64| {
        let found = sound(&farm(equal(nodes), vec![job(1, None, Division::UpTo(most), &[36_000])]));
        let parts = parts_of(&found, 1, 0).len() as i64;
        (found.jobs[0].verdict.finish().expect("a place"), parts, found.cost)
    };
    assert_eq!(ends(1, 500), (10 * HOUR, 1, 10_000_000));
    // 3 % of ten hours are 180 times six seconds.
    let (end, parts, cost) = ends(512, 500);
    assert!((150..=181).contains(&parts) && end < 5 * MINUTE, "{parts} parts end at {end}");
    assert!(cost <= 10_300_000 + parts, "{cost}");
    assert_eq!((ends(8, 500).1, ends(512, 20).1), (8, 20), "as many as it may have, or as there are nodes");
}

#[test]
fn a_still_leaves_dear_nodes_idle() {
    let dear = (10..20).map(|id| node(id, 1, 9_000_000));
    let found = sound(&farm(equal(10).chain(dear), vec![job(1, None, Division::UpTo(512), &[36_000])]));
    assert!(parts_of(&found, 1, 0).len() >= 10 && found.bookings.iter().all(|part| part.node < 10));
}

#[test]
fn the_longest_frame_does_not_decide_when_a_job_ends() {
    let mut works = [600; 40];
    works[7] = 36_000;
    let end = |division| {
        let found = sound(&farm(equal(20), vec![job(1, None, division, &works)]));
        (found.jobs[0].verdict.finish().expect("a place"), found)
    };
    assert_eq!(end(Division::Whole).0, 10 * HOUR);
    let (divided, found) = end(Division::UpTo(64));
    // All work on 20 nodes takes 49 minutes.
    assert!(divided < 53 * MINUTE, "{divided}");
    let whole = found.bookings.iter().filter(|booking| matches!(booking.task, Task::Frame(_))).count();
    assert!(whole >= 20, "most short frames stay whole: {whole}");
}

#[test]
fn a_job_that_cannot_be_in_time_whole_can_be_allowed_parts() {
    let input = farm(equal(4), vec![job(1, Some(HOUR / 2), Division::Whole, &[3600])]);
    let ways = ways_out(&input, 1).expect("ways out");
    assert!(ways.iter().any(|way| way.change == Change::Parts { job: 1, parts: 4 }), "{ways:?}");
    let mut unknown = input.clone();
    unknown.jobs[0].part_overhead = 0;
    let ways = ways_out(&unknown, 1).expect("ways out");
    assert!(
        !ways.iter().any(|way| matches!(way.change, Change::Parts { .. })),
        "nothing is known of dividing"
    );
}

#[test]
fn parts_stay_together_or_are_placed_anew_after_an_event() {
    let input = farm(equal(4), vec![job(1, Some(HOUR), Division::UpTo(8), &[7200, 3600])]);
    let old = sound(&input);
    let parts = parts_of(&old, 1, 0);
    assert!(parts.len() > 1);
    let down = Event::NodeDown { node: parts[0].node, from: parts[0].start, until: None };
    let new = replan(&input, &old, &down).expect("a plan");
    assert_eq!(verify(&new.input, &new.plan), Ok(()));
    let takes = Event::Takes { job: 1, task: parts[1].task, until: parts[1].end + MINUTE };
    let new = replan(&input, &old, &takes).expect("a plan");
    assert_eq!(verify(&new.input, &new.plan), Ok(()));
    assert!(parts_of(&new.plan, 1, 0).is_empty(), "all parts of the frame are fixed");
    assert_eq!(new.input.fixed.len(), parts.len());
    assert_eq!(parts_of(&new.plan, 1, 1), parts_of(&old, 1, 1));
}

#[test]
fn a_frame_cannot_be_required_to_have_millions_of_parts() {
    let input = farm(equal(1), vec![job(1, None, Division::Into(5_000_000), &[10])]);
    let parts = 5_000_000;
    assert_eq!(plan(&input), Err(InputError::TooManyParts { job: 1, frame: 0, parts }));
}

/// The end of the last frame of a shot over the mean end of the nodes that work for it, from the release.
fn unevenness(plan: &Plan) -> f64 {
    let mut ends = std::collections::BTreeMap::new();
    for booking in &plan.bookings {
        let end = ends.entry(booking.node).or_insert(0);
        *end = booking.end.max(*end);
    }
    let last = ends.values().max().copied().unwrap_or(0) as f64;
    last * ends.len() as f64 / ends.values().sum::<i64>() as f64
}

proptest! {
    #[test]
    fn nodes_of_a_shot_end_together(
        speeds in prop::collection::vec(1u64..5, 1..30),
        per_node in 2usize..6,
        works in prop::collection::vec(1800u64..7200, 180),
        long in 0u64..8,
    ) {
        let mut works = works[..speeds.len() * per_node].to_vec();
        works[0] *= 1 + long;
        let nodes = speeds.iter().zip(0..).map(|(&speed, id)| node(id, speed, speed as i64 * 1_000_000));
        let nodes: Vec<Node> = nodes.collect();
        let whole = sound(&farm(nodes.clone(), vec![job(1, None, Division::Whole, &works)]));
        let divided = sound(&farm(nodes, vec![job(1, None, Division::UpTo(64), &works)]));
        prop_assert!(unevenness(&divided) <= 1.05, "{} instead of {}", unevenness(&divided), unevenness(&whole));
        prop_assert!(divided.jobs[0].verdict.finish() <= whole.jobs[0].verdict.finish());
        prop_assert!(divided.cost as f64 <= whole.cost as f64 * 1.031, "{} after {}", divided.cost, whole.cost);
    }

    #[test]
    fn a_divided_frame_never_ends_after_its_bound_allows(
        speeds in prop::collection::vec(1u64..9, 1..12),
        works in prop::collection::vec((1u64..9000, 0u32..20), 1..12),
        into in any::<bool>(),
        deadline in prop::option::of(1i64..8),
    ) {
        let nodes = speeds.iter().zip(0..).map(|(&speed, id)| node(id, speed, 1_000_000));
        let mut jobs = vec![job(1, deadline.map(|hours| hours * HOUR / 4), Division::Whole, &works.iter().map(|work| work.0).collect::<Vec<_>>())];
        for (frame, &(_, parts)) in jobs[0].frames.iter_mut().zip(&works) {
            frame.division = if into { Division::Into(parts) } else { Division::UpTo(parts) };
        }
        let input = farm(nodes, jobs);
        let found = sound(&input);
        for frame in &input.jobs[0].frames {
            let count = parts_of(&found, 1, frame.number).len() as u32;
            prop_assert!(frame.division.allows(count), "{count} of {:?}", frame.division);
        }
        let Verdict::Late { unavoidable, .. } = found.jobs[0].verdict else { return Ok(()) };
        prop_assert!(!unavoidable || found.jobs[0].bound.earliest_finish() > input.jobs[0].deadline);
    }
}
