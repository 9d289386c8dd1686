//! The method: list scheduling in the order of deadlines. The crate's `README.md` says why.

use std::cmp::Reverse;

use crate::bound::{bound, placement};
use crate::calendar::FreeTime;
use crate::model::{Booking, Bound, Input, InputError, Job, JobPlan, Node, Plan, Verdict};

/// Makes a plan.
///
/// Jobs go by deadline (those without one last), then greater priority, then lower id. Their frames go
/// longest first (then by number), each to the node that finishes it earliest in its free time (then the
/// cheaper one, then the lower id). The plan depends on what is in the input, not on the order in which it is
/// given.
///
/// # Errors
/// If the input has no meaning; see [`InputError`]. What cannot be met is no error but a verdict.
pub fn plan(input: &Input) -> Result<Plan, InputError> {
    input.check()?;
    let mut nodes: Vec<&Node> = input.nodes.iter().collect();
    nodes.sort_unstable_by_key(|node| node.id);
    let mut farm: Vec<(&Node, FreeTime)> =
        nodes.into_iter().map(|node| (node, FreeTime::new(node, &input.fixed))).collect();
    let mut jobs: Vec<&Job> = input.jobs.iter().collect();
    jobs.sort_unstable_by_key(|job| (job.deadline.is_none(), job.deadline, Reverse(job.priority), job.id));

    // Bounds are taken before anything is booked, for they hold whatever the plan.
    let bounds: Vec<Bound> = jobs.iter().map(|job| bound(&farm, job.release, &job.bought_work())).collect();
    let mut plan = Plan { bound: bound_of_all(&farm, &jobs, &bounds), ..Plan::default() };
    for (job, bound) in jobs.into_iter().zip(bounds) {
        let (bookings, unplaced) = place(&mut farm, job);
        let finish = bookings.iter().map(|booking| booking.end).max().unwrap_or(job.release);
        let cost = bookings.iter().fold(0i64, |cost, booking| cost.saturating_add(price(&farm, booking)));
        plan.jobs.push(JobPlan {
            job: job.id,
            verdict: verdict(job, finish, unplaced, bound),
            cost,
            within_budget: job.budget.map(|budget| cost <= budget),
            bound,
        });
        plan.bookings.extend(bookings);
        plan.cost = plan.cost.saturating_add(cost);
    }
    plan.bookings.sort_unstable();
    plan.jobs.sort_unstable_by_key(|job| job.job);
    Ok(plan)
}

/// The bound of all jobs together. All work counts from the first release; but the longest frames count from
/// their own, by way of their job's bound.
fn bound_of_all(farm: &[(&Node, FreeTime)], jobs: &[&Job], bounds: &[Bound]) -> Bound {
    let Some(release) = jobs.iter().map(|job| job.release).min() else { return Bound::default() };
    let works: Vec<u64> = jobs.iter().flat_map(|job| job.bought_work()).collect();
    let ends: Option<Vec<i64>> = bounds.iter().map(|bound| bound.by_longest_frame).collect();
    Bound {
        by_capacity: bound(farm, release, &works).by_capacity,
        by_longest_frame: ends.and_then(|ends| ends.into_iter().max()),
    }
}

/// Books a job's frames and returns the bookings with the numbers of the frames that fit nowhere.
fn place(farm: &mut [(&Node, FreeTime)], job: &Job) -> (Vec<Booking>, Vec<i64>) {
    let works = job.bought_work();
    let mut frames: Vec<(u64, i64)> =
        job.frames.iter().zip(works).map(|(frame, work)| (work, frame.number)).collect();
    frames.sort_unstable_by_key(|&(work, number)| (Reverse(work), number));
    let mut bookings = Vec::with_capacity(frames.len());
    let mut unplaced = Vec::new();
    for (work, number) in frames {
        let best = farm
            .iter()
            .enumerate()
            .filter_map(|(index, (node, free))| {
                let (start, end) = placement(node, free, job.release, work)?;
                Some((end, node.price(end - start), node.id, start, index))
            })
            .min();
        match best {
            Some((end, _, node, start, index)) => {
                farm[index].1.take(start, end);
                bookings.push(Booking { start, node, job: job.id, frame: number, end });
            }
            None => unplaced.push(number),
        }
    }
    unplaced.sort_unstable();
    (bookings, unplaced)
}

fn price(farm: &[(&Node, FreeTime)], booking: &Booking) -> i64 {
    // The farm is in the order of ids, and bookings are made on its nodes only.
    let node = farm.binary_search_by_key(&booking.node, |(node, _)| node.id);
    node.map_or(0, |index| farm[index].0.price(booking.end - booking.start))
}

fn verdict(job: &Job, finish: i64, unplaced: Vec<i64>, bound: Bound) -> Verdict {
    if !unplaced.is_empty() {
        return Verdict::Unplaced { frames: unplaced };
    }
    match job.deadline {
        None => Verdict::NoDeadline { finish },
        Some(deadline) if finish <= deadline => {
            Verdict::Feasible { finish, slack: deadline.saturating_sub(finish) }
        }
        Some(deadline) => Verdict::Late {
            finish,
            by: finish.saturating_sub(deadline),
            unavoidable: bound.earliest_finish().is_none_or(|earliest| earliest > deadline),
        },
    }
}
