use std::collections::{BTreeMap, BTreeSet};

use super::violation::Violation;
use crate::model::{Booking, Bound, Input, Job, JobPlan, Node, SharedCache, Task, Verdict};

/// Checks every task and the job's entry. Returns the end of the last task, or `None` if one is unplaced.
pub(super) fn check_job(
    nodes: &BTreeMap<u64, &Node>,
    input: &Input,
    job: &Job,
    entry: &JobPlan,
    bookings: &[Booking],
    cost: i128,
    found: &mut Vec<Violation>,
) -> Option<i64> {
    let works: BTreeMap<i64, u64> = job.open_work().collect();
    let (unplaced, cache_unplaced) = match &entry.verdict {
        Verdict::Unplaced { frames, shared_cache } => (&frames[..], *shared_cache),
        _ => (&[][..], false),
    };
    let cache_end =
        bookings.iter().filter(|booking| booking.task.is_shared_cache()).map(|booking| booking.end).max();
    let release = job.release.max(input.now);
    let mut tasks: BTreeSet<Task> = BTreeSet::new();
    for &booking in bookings {
        let work = match booking.task {
            task @ (Task::SharedCache | Task::SharedCachePart { .. }) => {
                job.shared_cache.zip(job.shared_cache_work(task)).map(|(cache, work)| (cache.class, work))
            }
            Task::Frame(frame) => works.get(&frame).map(|&work| (job.class, work)),
        };
        let Some((class, work)) = work else {
            found.push(Violation::Unknown(booking));
            continue;
        };
        if !tasks.insert(booking.task) {
            found.push(Violation::Twice { job: job.id, task: booking.task });
        }
        if booking.start < release {
            found.push(Violation::Release(booking));
        }
        let is_frame = !booking.task.is_shared_cache();
        if is_frame && job.shared_cache.is_some() && cache_end.is_none_or(|end| booking.start < end) {
            found.push(Violation::Precedence(booking));
        }
        if let Some(node) = nodes.get(&booking.node) {
            if node.speed_of(class) == 0 {
                found.push(Violation::Unfit(booking));
            }
            let end = node.duration(work, class).and_then(|duration| booking.start.checked_add(duration));
            if end != Some(booking.end) {
                found.push(Violation::Duration(booking));
            }
        }
    }
    check_complete(job, &tasks, unplaced, cache_unplaced, &works, found);

    let finish = bookings.iter().map(|booking| booking.end).max().unwrap_or(release);
    if !is_true(job, entry, finish) {
        found.push(Violation::Verdict { job: job.id });
    }
    let cost = i64::try_from(cost).unwrap_or(i64::MAX);
    if entry.cost != cost || entry.within_budget != job.budget.map(|budget| cost <= budget) {
        found.push(Violation::Cost { job: job.id, stated: entry.cost, found: cost });
    }
    let is_placed = unplaced.is_empty() && !cache_unplaced;
    if is_placed && beats(finish, entry.bound) {
        found.push(Violation::Bound { job: Some(job.id) });
    }
    is_placed.then_some(finish)
}

/// Every frame and every part of the shared cache is either booked or listed as unplaced.
fn check_complete(
    job: &Job,
    tasks: &BTreeSet<Task>,
    unplaced: &[i64],
    cache_unplaced: bool,
    works: &BTreeMap<i64, u64>,
    found: &mut Vec<Violation>,
) {
    let mut called = BTreeSet::new();
    for &frame in unplaced {
        let task = Task::Frame(frame);
        if !works.contains_key(&frame) {
            found.push(Violation::UnknownUnplaced { job: job.id, task });
        } else if !called.insert(frame) || tasks.contains(&task) {
            found.push(Violation::Twice { job: job.id, task });
        }
    }
    let missing = works.keys().filter(|frame| !called.contains(frame)).map(|&frame| Task::Frame(frame));
    for task in missing.filter(|task| !tasks.contains(task)) {
        found.push(Violation::Missing { job: job.id, task });
    }
    let mut parts = job.shared_cache.into_iter().flat_map(SharedCache::tasks);
    let missing = parts.find(|part| !tasks.contains(part));
    match (job.shared_cache.is_some(), missing, cache_unplaced) {
        (true, Some(task), false) => found.push(Violation::Missing { job: job.id, task }),
        (true, None, true) => found.push(Violation::Twice { job: job.id, task: Task::SharedCache }),
        (false, _, true) => found.push(Violation::UnknownUnplaced { job: job.id, task: Task::SharedCache }),
        _ => {}
    }
}

/// Whether the verdict follows from the deadline and the last end.
fn is_true(job: &Job, entry: &JobPlan, end: i64) -> bool {
    match (&entry.verdict, job.deadline) {
        (Verdict::Unplaced { frames, shared_cache }, _) => !frames.is_empty() || *shared_cache,
        (Verdict::NoDeadline { finish }, None) => *finish == end,
        (Verdict::Feasible { finish, slack }, Some(deadline)) => {
            *finish == end && end <= deadline && *slack == deadline.saturating_sub(end)
        }
        (Verdict::Late { finish, by, unavoidable }, Some(deadline)) => {
            let possible = entry.bound.earliest_finish().is_some_and(|earliest| earliest <= deadline);
            *finish == end
                && end > deadline
                && *by == end.saturating_sub(deadline)
                && *unavoidable != possible
        }
        _ => false,
    }
}

pub(super) fn beats(end: i64, bound: Bound) -> bool {
    bound.earliest_finish().is_none_or(|earliest| end < earliest)
}
