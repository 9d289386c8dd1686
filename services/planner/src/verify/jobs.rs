use std::collections::{BTreeMap, BTreeSet};

use super::violation::Violation;
use crate::model::{Booking, Bound, Division, Input, Job, JobPlan, Node, SharedCache, Task, Verdict};

/// By number of a frame that needs a booking: its work as a whole, and how it may be divided.
type Frames = BTreeMap<i64, (u64, Division)>;

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
    let frames: Frames =
        job.open_frames().map(|(frame, work)| (frame.number, (work, frame.division))).collect();
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
            Task::Frame(frame) => frames.get(&frame).map(|&(work, _)| (job.class, work)),
            Task::Part { frame, parts, .. } => {
                frames.get(&frame).map(|&(work, _)| (job.class, job.part_work(work, parts)))
            }
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
    check_frames(job, &frames, &tasks, bookings, unplaced, found);
    check_shared_cache(job, &tasks, cache_unplaced, found);

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

/// Every frame is booked as it may be divided, or listed as unplaced.
fn check_frames(
    job: &Job,
    frames: &Frames,
    tasks: &BTreeSet<Task>,
    bookings: &[Booking],
    unplaced: &[i64],
    found: &mut Vec<Violation>,
) {
    let mut by_frame: BTreeMap<i64, Vec<Booking>> = BTreeMap::new();
    for &booking in bookings {
        if let Some(frame) = booking.task.frame() {
            by_frame.entry(frame).or_default().push(booking);
        }
    }
    let mut called = BTreeSet::new();
    for &frame in unplaced {
        let task = Task::Frame(frame);
        if !frames.contains_key(&frame) {
            found.push(Violation::UnknownUnplaced { job: job.id, task });
        } else if !called.insert(frame) || by_frame.contains_key(&frame) {
            found.push(Violation::Twice { job: job.id, task });
        }
    }
    for (&frame, &(_, division)) in frames.iter().filter(|(frame, _)| !called.contains(frame)) {
        match by_frame.get(&frame) {
            None => found.push(Violation::Missing { job: job.id, task: Task::Frame(frame) }),
            Some(bookings) => check_parts(job, division, tasks, bookings, found),
        }
    }
}

/// The bookings of a frame are one of all of it, or one of each of its parts. They have a number that the
/// division allows.
fn check_parts(
    job: &Job,
    division: Division,
    tasks: &BTreeSet<Task>,
    bookings: &[Booking],
    found: &mut Vec<Violation>,
) {
    let Some(&Booking { task: first, .. }) = bookings.first() else { return };
    let parts_of = |task: Task| match task {
        Task::Part { parts, .. } => parts,
        _ => 1,
    };
    let is_right = |task: Task| match task {
        Task::Part { part, parts, .. } => part < parts && parts > 1 && parts == parts_of(first),
        _ => parts_of(first) == 1,
    };
    let wrong = |booking: &&Booking| !is_right(booking.task) || !division.allows(parts_of(booking.task));
    let before = found.len();
    found.extend(bookings.iter().filter(wrong).map(|&booking| Violation::Division(booking)));
    if let Task::Part { frame, parts, .. } = first
        && found.len() == before
    {
        let missing =
            (0..parts).map(|part| Task::Part { frame, part, parts }).find(|part| !tasks.contains(part));
        found.extend(missing.map(|task| Violation::Missing { job: job.id, task }));
    }
}

/// Every part of the shared cache is booked, or it is listed as unplaced.
fn check_shared_cache(job: &Job, tasks: &BTreeSet<Task>, unplaced: bool, found: &mut Vec<Violation>) {
    let mut parts = job.shared_cache.into_iter().flat_map(SharedCache::tasks);
    let missing = parts.find(|part| !tasks.contains(part));
    match (job.shared_cache.is_some(), missing, unplaced) {
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
