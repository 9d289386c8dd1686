//! Questions about farms whose answers can be worked out by hand.

use forelight_protocol::{FramePart, NodeId, PlanChange, SharedCacheBooking, WhatIf};
use forelight_store::{Holder, OpenBooking, OpenCachePart, TaskAttempt};
use serde_json::Value;

use super::*;
use crate::conductor::made_up::{at, booking, farm_job, job_id, node, node_id, snapshot, waiting};
use crate::conductor::what_if::what_if;

const HOUR: i64 = 3600;

fn own() -> JobId {
    job_id(9)
}

/// A worker on this node that has just begun, on a node on which it takes an hour.
fn begins(node: u128) -> Holder {
    let attempt = TaskAttempt { since: at(0), progress: 0.0, sign: at(0), p95: Some(HOUR * SECOND) };
    Holder { node_id: node_id(node), started: at(0), attempt, slowness: 1.0 }
}

fn under_way(frame: u32, node: u128) -> OpenBooking {
    OpenBooking { booking: booking(own(), frame, node, (0, HOUR)), holder: Some(begins(node)), held: false }
}

fn effects_of(snapshot: &Snapshot) -> Vec<PlanEffect> {
    let farm = Farm::new(snapshot);
    effects(snapshot, &farm, farm.place(own()).unwrap()).unwrap()
}

fn without(snapshot: &Snapshot, node: NodeId) -> WhatIf {
    what_if(snapshot, own(), &PlanChange::NodeGone { node_id: node }, &[]).unwrap().unwrap()
}

#[test]
fn without_a_node_its_frames_under_way_are_rendered_again_elsewhere() {
    let nodes = vec![node(1, 1_000_000, 1000, Value::Null), node(2, 1_000_000, 1000, Value::Null)];
    let open = [under_way(0, 2), waiting(booking(own(), 1, 2, (HOUR, 2 * HOUR)))];
    let snapshot = snapshot(nodes, vec![farm_job(own(), &open)], &open, &[]);
    let found = effects_of(&snapshot);
    let gone = PlanChange::NodeGone { node_id: node_id(2) };
    let gone = found.iter().find(|effect| effect.change == gone).expect("it works for the job");
    assert_eq!(gone.finish, Some(at(2 * HOUR)), "both frames on the other node");
    assert_eq!(gone.added_cost, Money(1_000_000), "one of them is paid twice");
    let asked = without(&snapshot, node_id(2)).effect;
    assert_eq!((asked.finish, asked.added_cost), (gone.finish, gone.added_cost));
}

#[test]
fn without_a_node_its_part_of_a_cache_is_filled_elsewhere() {
    let nodes = vec![node(1, 0, 1000, Value::Null), node(2, 0, 1000, Value::Null)];
    let part = |part, (start, end)| SharedCacheBooking {
        job_id: own(),
        part,
        node_id: node_id(2),
        start: at(start),
        end: at(end),
    };
    let parts = [
        OpenCachePart { booking: part(0, (0, HOUR)), done: 0.5, holder: Some(begins(2)), held: false },
        OpenCachePart { booking: part(1, (HOUR, 2 * HOUR)), done: 0.0, holder: None, held: false },
    ];
    let open = [under_way(0, 1), waiting(booking(own(), 1, 1, (2 * HOUR, 3 * HOUR)))];
    let before = snapshot(nodes, vec![farm_job(own(), &open)], &open, &parts);
    assert_eq!(before.projected.cache_full_at(own()), Some(at(2 * HOUR)));
    let mut after = before.clone();
    take_away(&mut after, node_id(2));
    // Behind the frame that the other node has.
    let places: Vec<_> = after.projected.cache_parts.iter().map(|part| (part.node_id, part.start)).collect();
    assert_eq!(places, [(node_id(1), at(HOUR)), (node_id(1), at(2 * HOUR))]);
    assert_eq!(after.projected.cache_full_at(own()), Some(at(3 * HOUR)));
    assert_eq!(without(&before, node_id(2)).effect.finish, Some(at(4 * HOUR)));
}

#[test]
fn what_it_brings_to_plan_anew_is_no_effect_of_one_more_node() {
    // It is booked on the dear node, and the cheap one has become free.
    let nodes = vec![node(1, 1_000_000, 1000, Value::Null), node(2, 9_000_000, 1000, Value::Null)];
    let open = [waiting(booking(own(), 0, 2, (0, HOUR)))];
    let mut job = farm_job(own(), &open);
    job.job.deadline = Some(at(9 * HOUR));
    let snapshot = snapshot(nodes, vec![job], &open, &[]);
    let found = effects_of(&snapshot);
    let more = found.iter().filter(|effect| matches!(effect.change, PlanChange::MoreNodes { .. }));
    let costs: Vec<Money> = more.map(|effect| effect.added_cost).collect();
    assert_eq!(costs, [Money(0); 2]);
}

#[test]
fn parts_of_a_divided_frame_share_what_it_takes_longer_than_forecast() {
    let part = |part, start| {
        let booking = booking(own(), 3, 1, (start, start + HOUR / 2));
        waiting(forelight_protocol::Booking { part, parts: 2, ..booking })
    };
    let open = [part(0, 0), part(1, HOUR), waiting(booking(own(), 4, 1, (2 * HOUR, 3 * HOUR)))];
    let nodes = vec![node(1, 0, 1000, Value::Null)];
    let farm = Farm::new(&snapshot(nodes, vec![farm_job(own(), &open)], &open, &[]));
    let of: Vec<Option<i64>> = farm.input.jobs[0].frames.iter().map(|frame| frame.part_of).collect();
    assert_eq!(of, [Some(3), Some(3), None]);
    assert_ne!(open[0].booking.frame_part(), FramePart::from(3));
}

#[test]
fn durations_counts_and_changes_are_told_in_good_english() {
    use super::super::effects::all_nodes;
    assert_eq!(
        [counted(0, "node"), counted(1, "node"), counted(2, "node")],
        ["0 nodes", "1 node", "2 nodes"]
    );
    assert_eq!([all_nodes(1), all_nodes(3)], ["the only node", "all 3 nodes"]);
    let open = [waiting(booking(own(), 0, 1, (0, HOUR)))];
    let nodes = vec![node(1, 0, 1000, Value::Null)];
    let farm = Farm::new(&snapshot(nodes, vec![farm_job(own(), &open)], &open, &[]));
    let moved = |count: usize| {
        vec![MovedJob { job_id: own(), name: "b".into(), later_ms: 1, breaks_promise: false }; count]
    };
    let told = |change: &Change, count| farm.told(change, 0, None, true, &moved(count), 0).unwrap().words;
    let later = |seconds: i64| Change::Later { job: 0, by: seconds * SECOND };
    assert_eq!(
        told(&later(-90), 1),
        "the deadline 1 min 30 s earlier: at no extra cost; 1 other job ends later"
    );
    assert_eq!(
        told(&later(90), 2),
        "the deadline 1 min 30 s later: at no extra cost; 2 other jobs end later"
    );
    let confidence = |confidence| told(&Change::Confidence { job: 0, confidence }, 0);
    let [less, same, more] =
        [planner::Confidence::P50, planner::Confidence::P80, planner::Confidence::P95].map(confidence);
    assert!(less.starts_with("at a confidence of 50 % only:"), "{less}");
    assert!(same.starts_with("at a confidence of 80 %:") && more.starts_with("at a confidence of 95 %:"));
}
