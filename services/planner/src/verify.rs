//! An independent check of a plan.
//!
//! It knows what a plan must be and nothing of how one is made: it uses the definitions of `model` alone, and
//! would pass a plan made by hand.

use std::collections::{BTreeMap, BTreeSet};

use crate::model::{Booking, Bound, Input, InputError, Interval, Job, JobPlan, Node, Plan, Verdict};

/// Something that is wrong with a plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Violation {
    /// The input itself has no meaning, so no plan can be right.
    #[error("the input has no meaning: {0}")]
    Input(#[from] InputError),
    /// A booking of an unknown node, job or frame.
    #[error("job {}, frame {} on node {}: no such thing", .0.job, .0.frame, .0.node)]
    Unknown(Booking),
    /// A frame has more than one booking, or is also said to be unplaced.
    #[error("job {job}, frame {frame} is booked twice, or booked and called unplaced")]
    Twice {
        /// The job.
        job: u64,
        /// Number of the frame.
        frame: i64,
    },
    /// A frame is neither booked nor called unplaced.
    #[error("job {job}, frame {frame} is missing")]
    Missing {
        /// The job.
        job: u64,
        /// Number of the frame.
        frame: i64,
    },
    /// A frame is called unplaced although it is not a frame of the job.
    #[error("job {job} has no frame {frame} that could be unplaced")]
    UnknownUnplaced {
        /// The job.
        job: u64,
        /// Number of the frame.
        frame: i64,
    },
    /// A booking does not last as long as its node takes for the frame's work.
    #[error("job {}, frame {} on node {}: not as long as its work takes", .0.job, .0.frame, .0.node)]
    Duration(Booking),
    /// A booking starts before its job is released.
    #[error("job {}, frame {} on node {}: starts before its release", .0.job, .0.frame, .0.node)]
    Release(Booking),
    /// A booking is not within the node's calendar, or before the node is available.
    #[error("job {}, frame {} on node {}: the node is not free for rendering", .0.job, .0.frame, .0.node)]
    Calendar(Booking),
    /// A booking overlaps another one, or a fixed one, on its node.
    #[error("job {}, frame {} on node {}: overlaps another booking", .0.job, .0.frame, .0.node)]
    Overlap(Booking),
    /// A job has no verdict, or more than one.
    #[error("job {job} has {verdicts} verdicts")]
    Verdicts {
        /// The job.
        job: u64,
        /// How many it has.
        verdicts: usize,
    },
    /// A verdict for a job that does not exist.
    #[error("a verdict names job {job}, which does not exist")]
    UnknownJob {
        /// The job.
        job: u64,
    },
    /// A verdict does not follow from the bookings.
    #[error("job {job}: the verdict is not what the bookings say")]
    Verdict {
        /// The job.
        job: u64,
    },
    /// A job's cost, or whether it is within budget, does not follow from the bookings.
    #[error(
        "job {job}: the cost is {stated}, but its bookings cost {found}, or the budget is judged wrongly"
    )]
    Cost {
        /// The job.
        job: u64,
        /// Cost in the plan.
        stated: i64,
        /// Cost of the bookings.
        found: i64,
    },
    /// The costs of the jobs do not add up to the plan's.
    #[error("the plan's cost is {stated}, but its bookings cost {found}")]
    TotalCost {
        /// Cost in the plan.
        stated: i64,
        /// Cost of the bookings.
        found: i64,
    },
    /// Something ends before the bound that nothing can beat.
    #[error("{}: ends before its bound", .job.map_or("the plan".into(), |job| format!("job {job}")))]
    Bound {
        /// The job, or none for all together.
        job: Option<u64>,
    },
}

/// Checks a plan against its input: every frame once, in its node's free time, after its release, as long as
/// its work takes, alone on its node; and verdicts, costs and bounds in agreement with the bookings.
///
/// # Errors
/// Everything that is wrong.
pub fn verify(input: &Input, plan: &Plan) -> Result<(), Vec<Violation>> {
    if let Err(error) = input.check() {
        return Err(vec![error.into()]);
    }
    let nodes: BTreeMap<u64, &Node> = input.nodes.iter().map(|node| (node.id, node)).collect();
    let mut by_node: BTreeMap<u64, Vec<Booking>> = BTreeMap::new();
    let mut by_job: BTreeMap<u64, Vec<Booking>> = BTreeMap::new();
    for &booking in &plan.bookings {
        by_node.entry(booking.node).or_default().push(booking);
        by_job.entry(booking.job).or_default().push(booking);
    }
    let mut found = Vec::new();

    for (id, bookings) in by_node {
        match nodes.get(&id) {
            Some(node) => check_node(input, node, bookings, &mut found),
            None => found.extend(bookings.into_iter().map(Violation::Unknown)),
        }
    }
    let mut total = 0i64;
    let mut ends = Some(i64::MIN);
    for job in &input.jobs {
        let bookings = by_job.remove(&job.id).unwrap_or_default();
        let verdicts: Vec<&JobPlan> = plan.jobs.iter().filter(|entry| entry.job == job.id).collect();
        match verdicts[..] {
            [entry] => {
                ends = ends.zip(check_job(&nodes, job, entry, &bookings, &mut found)).map(|(a, b)| a.max(b));
            }
            _ => found.push(Violation::Verdicts { job: job.id, verdicts: verdicts.len() }),
        }
        total = total.saturating_add(cost(&nodes, &bookings));
    }
    found.extend(by_job.into_values().flatten().map(Violation::Unknown));
    let known: BTreeSet<u64> = input.jobs.iter().map(|job| job.id).collect();
    let strangers = plan.jobs.iter().filter(|entry| !known.contains(&entry.job));
    found.extend(strangers.map(|entry| Violation::UnknownJob { job: entry.job }));
    if total != plan.cost {
        found.push(Violation::TotalCost { stated: plan.cost, found: total });
    }
    if !input.jobs.is_empty() && ends.is_some_and(|end| beats(end, plan.bound)) {
        found.push(Violation::Bound { job: None });
    }
    if found.is_empty() { Ok(()) } else { Err(found) }
}

/// No overlaps, and nothing outside the calendar.
fn check_node(input: &Input, node: &Node, mut bookings: Vec<Booking>, found: &mut Vec<Violation>) {
    bookings.sort_unstable();
    let mut open: Vec<Interval> = node.calendar.clone();
    open.sort_unstable_by_key(|interval| interval.start);
    let mut busy_until = i64::MIN;
    for booking in bookings {
        if booking.start < node.available_from || !covered(&open, booking.start, booking.end) {
            found.push(Violation::Calendar(booking));
        }
        if booking.start >= booking.end {
            continue;
        }
        let with_fixed = input
            .fixed
            .iter()
            .any(|f| f.node == node.id && f.start < f.end && f.start < booking.end && booking.start < f.end);
        if booking.start < busy_until || with_fixed {
            found.push(Violation::Overlap(booking));
        }
        busy_until = busy_until.max(booking.end);
    }
}

/// Whether the intervals, sorted by start, together cover all time from `start` to `end`.
fn covered(open: &[Interval], start: i64, end: i64) -> bool {
    let mut reached = start;
    for interval in open {
        if reached >= end || interval.start > reached {
            break;
        }
        match interval.end {
            None => return true,
            Some(until) => reached = reached.max(until),
        }
    }
    reached >= end
}

/// Every frame once and rightly booked, and what the plan says of the job is true. Returns the end of the
/// last frame, or none if a frame has no place.
fn check_job(
    nodes: &BTreeMap<u64, &Node>,
    job: &Job,
    entry: &JobPlan,
    bookings: &[Booking],
    found: &mut Vec<Violation>,
) -> Option<i64> {
    let works: BTreeMap<i64, u64> =
        job.frames.iter().map(|frame| frame.number).zip(job.bought_work()).collect();
    let unplaced: &[i64] = match &entry.verdict {
        Verdict::Unplaced { frames } => frames,
        _ => &[],
    };
    let mut seen = BTreeSet::new();
    for booking in bookings {
        let Some(&work) = works.get(&booking.frame) else {
            found.push(Violation::Unknown(*booking));
            continue;
        };
        if !seen.insert(booking.frame) {
            found.push(Violation::Twice { job: job.id, frame: booking.frame });
        }
        if booking.start < job.release {
            found.push(Violation::Release(*booking));
        }
        let end = |node: &&Node| node.duration(work).and_then(|duration| booking.start.checked_add(duration));
        if nodes.get(&booking.node).is_some_and(|node| end(node) != Some(booking.end)) {
            found.push(Violation::Duration(*booking));
        }
    }
    for &frame in unplaced {
        if !works.contains_key(&frame) {
            found.push(Violation::UnknownUnplaced { job: job.id, frame });
        } else if !seen.insert(frame) {
            found.push(Violation::Twice { job: job.id, frame });
        }
    }
    let missing = works.keys().filter(|frame| !seen.contains(frame));
    found.extend(missing.map(|&frame| Violation::Missing { job: job.id, frame }));

    let finish = bookings.iter().map(|booking| booking.end).max().unwrap_or(job.release);
    if !is_true(job, entry, finish) {
        found.push(Violation::Verdict { job: job.id });
    }
    let cost = cost(nodes, bookings);
    if entry.cost != cost || entry.within_budget != job.budget.map(|budget| cost <= budget) {
        found.push(Violation::Cost { job: job.id, stated: entry.cost, found: cost });
    }
    if unplaced.is_empty() && beats(finish, entry.bound) {
        found.push(Violation::Bound { job: Some(job.id) });
    }
    unplaced.is_empty().then_some(finish)
}

/// Whether the verdict is what the deadline and the last end make it.
fn is_true(job: &Job, entry: &JobPlan, end: i64) -> bool {
    match (&entry.verdict, job.deadline) {
        (Verdict::Unplaced { frames }, _) => !frames.is_empty(),
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

fn beats(end: i64, bound: Bound) -> bool {
    bound.earliest_finish().is_none_or(|earliest| end < earliest)
}

fn cost(nodes: &BTreeMap<u64, &Node>, bookings: &[Booking]) -> i64 {
    bookings.iter().fold(0i64, |cost, booking| {
        let price =
            nodes.get(&booking.node).map_or(0, |node| node.price(booking.end.saturating_sub(booking.start)));
        cost.saturating_add(price)
    })
}
