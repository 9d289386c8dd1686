//! The open bookings as planner input.

use std::collections::BTreeMap;

use forelight_planner::{self as planner, Interval};
use forelight_protocol::{JobId, NodeId};

use crate::conductor::farm::{Farm, Snapshot};
use crate::conductor::numbers::number;

/// The farm and the open bookings of jobs that are not held. Nodes are numbered by their place in the snapshot,
/// jobs in `jobs`.
pub(super) fn planner_input(snapshot: &Snapshot, jobs: &[JobId]) -> (planner::Input, planner::Plan) {
    let farm = Farm::new(snapshot);
    let nodes: BTreeMap<NodeId, u64> = snapshot.nodes.iter().map(|node| node.id).zip(0..).collect();
    let places: BTreeMap<JobId, u64> = farm.jobs.iter().map(|asked| asked.job.id).zip(0..).collect();
    let now = snapshot.now.micros();
    let mut bookings = under_way(snapshot, &nodes, &places);
    let mut input = planner::Input { fixed: Vec::new(), ..farm.input.clone() };
    for booking in &bookings {
        stay_open(&mut input.nodes[booking.node as usize], now, booking.end);
    }
    let held = |job: u64| farm.jobs[job as usize].held;
    bookings.extend(cache_parts(snapshot, &nodes, &places, false).filter(|booking| !held(booking.job)));
    bookings.extend(farm.standing.iter().filter(|booking| !held(booking.job)).cloned());
    bookings.sort_unstable();
    // The caller's list of jobs is longer: jobs without bookings have nothing to carry out.
    let own: BTreeMap<JobId, u64> = jobs.iter().copied().zip(0..).collect();
    let renamed: Vec<Option<u64>> = farm.jobs.iter().map(|asked| own.get(&asked.job.id).copied()).collect();
    let name = |job: u64| renamed.get(job as usize).copied().flatten();
    bookings.retain_mut(|booking| name(booking.job).map(|own| booking.job = own).is_some());
    input.jobs.retain_mut(|job| name(job.id).map(|own| job.id = own).is_some());
    for job in &mut input.jobs {
        // The parts of its cache are bookings here. In each scenario they decide when its frames can begin.
        job.release = now;
    }
    (input, planner::Plan { bookings, ..planner::Plan::default() })
}

/// Frames and cache parts that workers hold.
fn under_way(
    snapshot: &Snapshot,
    nodes: &BTreeMap<NodeId, u64>,
    places: &BTreeMap<JobId, u64>,
) -> Vec<planner::Booking> {
    let now = snapshot.now.micros();
    let frames = snapshot.projected.frames.iter().filter(|frame| frame.under_way).filter_map(|frame| {
        let (&node, &job) = nodes.get(&frame.node_id).zip(places.get(&frame.booking.job_id))?;
        let task = planner::Task::Frame(number(frame.booking.frame_part()));
        let end = frame.end.micros().max(now.saturating_add(1));
        Some(planner::Booking { start: now, node, job, task, end })
    });
    frames.chain(cache_parts(snapshot, nodes, places, true)).collect()
}

fn cache_parts<'a>(
    snapshot: &'a Snapshot,
    nodes: &'a BTreeMap<NodeId, u64>,
    places: &'a BTreeMap<JobId, u64>,
    under_way: bool,
) -> impl Iterator<Item = planner::Booking> + 'a {
    let now = snapshot.now.micros();
    let parts = snapshot.projected.cache_parts.iter();
    parts.filter(move |part| part.under_way == under_way).filter_map(move |part| {
        let (&node, &job) = nodes.get(&part.node_id).zip(places.get(&part.booking.job_id))?;
        // The number of parts does not matter here.
        let task = planner::Task::SharedCachePart {
            part: part.booking.part,
            parts: part.booking.part.saturating_add(1),
        };
        Some(planner::Booking {
            start: part.start.micros().max(now),
            node,
            job,
            task,
            end: part.end.micros(),
        })
    })
}

/// Keeps a running task's node open past its window, for twice the expected time.
fn stay_open(node: &mut planner::Node, now: i64, end: i64) {
    let end = end.saturating_add(end.saturating_sub(now));
    node.calendar.push(Interval { start: now, end: Some(end) });
}
