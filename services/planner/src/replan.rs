//! New plans after an event, with as few moves as possible.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::admission::Admission;
use crate::answers::{Change, find, node, own_job};
use crate::bound::{bound, bound_of_all};
use crate::difference::{Difference, difference_from};
use crate::model::{
    Booking, Bound, FixedBooking, Input, InputError, Interval, Job, JobPlan, Node, Plan, PlanId, Task,
};
use crate::outcome;
use crate::problem::Problem;
use crate::rescue::{Rescue, rescues};
use crate::schedule::{as_early_as_possible, in_turns, place_in_time};
use crate::state::{Placed, State};

/// The most jobs that are asked to make way for one.
const MOST_ASKED: usize = 12;

/// Something that happened on the farm.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Event {
    /// A node died, or is being serviced.
    NodeDown {
        /// The node.
        node: u64,
        /// From this instant on.
        from: i64,
        /// Until this instant. `None`: unknown.
        until: Option<i64>,
    },
    /// A node was added.
    NodeUp {
        /// The node.
        node: Box<Node>,
    },
    /// A running or finished task ends at a different time than planned.
    Takes {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
        /// When it ends.
        until: i64,
    },
    /// A job was added.
    JobAdded {
        /// The job.
        job: Box<Job>,
    },
    /// A job was withdrawn.
    JobRemoved {
        /// The job.
        job: u64,
    },
    /// A deadline changed.
    DeadlineMoved {
        /// The job.
        job: u64,
        /// The new one.
        deadline: Option<i64>,
    },
}

/// A plan after an event.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Replanned {
    /// The input after the event.
    pub input: Input,
    /// The new plan. Its parent is the old one.
    pub plan: Plan,
    /// The difference from the old plan.
    pub difference: Difference,
    /// Promises that the old plan kept and this one breaks.
    pub at_risk: Vec<AtRisk>,
}

/// A promise that can no longer be kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AtRisk {
    /// The job.
    pub job: u64,
    /// When the job would now end. `None`: never.
    pub finish: Option<i64>,
    /// The cheapest rescue found.
    pub rescue: Option<Rescue>,
}

/// Makes a new plan after an event.
///
/// Bookings that are still valid stay. The rest is placed at the least cost that keeps its deadline. If that
/// fails, one other job at a time makes way, if it can keep its own deadline elsewhere. If that fails too,
/// the promise is reported as at risk, with the cheapest rescue.
///
/// # Errors
/// If the input is invalid before or after the event.
pub fn replan(input: &Input, old: &Plan, event: &Event) -> Result<Replanned, InputError> {
    input.check()?;
    let (input, taken) = after(input, old, event)?;
    let still: Vec<Booking> = old
        .bookings
        .iter()
        .filter(|booking| !taken.contains(&(booking.job, booking.task)))
        .copied()
        .collect();
    let mut replanned = mended(input, old, &still)?;
    let late = late_by_fact(&replanned.input, old, &replanned.plan, event);
    replanned.at_risk.extend(late);
    Ok(replanned)
}

/// As [`replan`], for an input that already holds the change. `old` gives the current bookings, and its
/// verdicts the promises. Jobs that it does not name are new.
///
/// # Errors
/// If the input is invalid.
pub fn mend(input: &Input, old: &Plan) -> Result<Replanned, InputError> {
    mended(Input { movable: Vec::new(), ..input.clone() }, old, &old.bookings)
}

fn mended(input: Input, old: &Plan, still: &[Booking]) -> Result<Replanned, InputError> {
    input.check()?;
    let problem = Problem::new(&input);
    let admission = Admission::none(&problem);
    let mut state = State::new(&problem, &admission);
    state.keep(still);
    repair(&mut state);
    let bounds: Vec<Bound> = problem.jobs.iter().map(|work| bound(&problem, work)).collect();
    let together = bound_of_all(&problem, &bounds);
    let parent: PlanId = old.id();
    // Prices prove a bound for any input, though perhaps a weaker one.
    let inherited = Admission::none(&problem).with_proof(old.proof.clone());
    let plan = outcome::plan(&state, &inherited, bounds, together, Some(parent));
    let at_risk = at_risk(&input, old, &plan)?;
    let difference = difference_from(parent, old, &plan);
    drop(state);
    Ok(Replanned { plan, difference, at_risk, input })
}

/// The input after the event, and the tasks whose bookings became fixed by it.
fn after(input: &Input, old: &Plan, event: &Event) -> Result<(Input, Vec<(u64, Task)>), InputError> {
    let mut new = Input { movable: Vec::new(), ..input.clone() };
    let mut taken = Vec::new();
    match event {
        Event::NodeDown { node: down, from, until } => {
            node(input, *down)?;
            let closed = Interval { start: *from, end: *until };
            new.nodes
                .iter_mut()
                .filter(|node| node.id == *down)
                .for_each(|node| node.maintenance.push(closed));
        }
        Event::NodeUp { node } => new.nodes.push((**node).clone()),
        Event::Takes { job, task, until } => {
            find(input, *job)?;
            let booking = old.bookings.iter().find(|booking| (booking.job, booking.task) == (*job, *task));
            if let Some(booking) = booking {
                let job = own_job(&mut new, *job)?;
                // The task becomes a fixed booking. A finished shared cache becomes a later release.
                let facts: Vec<&Booking> = match task.frame() {
                    // With one part, all parts of the shared cache become fixed.
                    None => {
                        let of_cache =
                            |other: &&Booking| other.job == booking.job && other.task.is_shared_cache();
                        let parts: Vec<&Booking> = old.bookings.iter().filter(of_cache).collect();
                        let others = parts.iter().filter(|part| part.task != *task).map(|part| part.end);
                        let end = others.max().map_or(*until, |end| end.max(*until));
                        job.shared_cache = None;
                        job.release = job.release.max(end);
                        parts
                    }
                    // With one part, all parts of the frame become fixed.
                    Some(number) => {
                        job.done.push(number);
                        let of_frame =
                            |other: &&Booking| other.job == booking.job && other.task.frame() == Some(number);
                        old.bookings.iter().filter(of_frame).collect()
                    }
                };
                for fact in &facts {
                    let end = if fact.task == *task { (*until).max(fact.start) } else { fact.end };
                    let (node, start, job) = (fact.node, fact.start, Some(fact.job));
                    new.fixed.push(FixedBooking { node, start, end, job });
                }
                taken = facts.iter().map(|fact| (fact.job, fact.task)).collect();
            }
        }
        Event::JobAdded { job } => new.jobs.push((**job).clone()),
        Event::JobRemoved { job } => {
            find(input, *job)?;
            new.jobs.retain(|other| other.id != *job);
        }
        Event::DeadlineMoved { job, deadline } => own_job(&mut new, *job)?.deadline = *deadline,
    }
    Ok((new, taken))
}

/// Places tasks without a place, and those past their deadline, the earliest deadline first. Jobs without a
/// deadline follow by priority, and in turns.
fn repair(state: &mut State) {
    let problem = state.problem;
    let open: Vec<usize> = (0..problem.jobs.len()).filter(|&job| is_open(state, job)).collect();
    let has_deadline = |&job: &usize| problem.jobs[job].job.deadline.is_some();
    let (mut promised, others): (Vec<usize>, Vec<usize>) = open.into_iter().partition(has_deadline);
    promised.sort_unstable_by_key(|&job| {
        let job = problem.jobs[job].job;
        (job.deadline, Reverse(job.priority), job.id)
    });
    for job in promised {
        let before = (state.missing_tasks(job), state.finish(job));
        let late = move_what_is_late(state, job);
        if place_in_time(state, job) || make_way(state, job) {
            continue;
        }
        as_early_as_possible(state, job);
        if (state.missing_tasks(job), state.finish(job)) >= before {
            // No improvement: the late tasks go back to where they were.
            state.unbook_after(job, state.kept[job]);
            late.into_iter().for_each(|placed| state.book(job, placed));
        }
    }
    place_by_priority(state, &others);
}

/// Places jobs without a deadline, the highest priority first. Frames of others without a deadline make way for
/// jobs of higher priority, if they come before the end of these. Where their time stays free, they go back to it.
fn place_by_priority(state: &mut State, open: &[usize]) {
    let problem = state.problem;
    let rank = |job: usize| Reverse(problem.jobs[job].job.priority);
    let mut waiting: BTreeMap<Reverse<i32>, BTreeMap<u64, usize>> = BTreeMap::new();
    let wait = |waiting: &mut BTreeMap<_, BTreeMap<u64, usize>>, job: usize| {
        waiting.entry(rank(job)).or_default().insert(problem.jobs[job].job.id, job);
    };
    open.iter().for_each(|&job| wait(&mut waiting, job));
    while let Some((level, group)) = waiting.pop_first() {
        let group: Vec<usize> = group.into_values().collect();
        let before: Vec<usize> = group.iter().map(|&job| state.placed[job].len()).collect();
        in_turns(state, &group);
        // Only what comes before the end of what was placed just now can be in its way.
        let placed = group.iter().zip(&before).flat_map(|(&job, &count)| &state.placed[job][count..]);
        let Some(end) = placed.map(|placed| placed.end).max() else { continue };
        let classes: BTreeSet<usize> =
            group.iter().flat_map(|&job| problem.jobs[job].classes.iter().copied()).collect();
        let is_in_the_way =
            |placed: &Placed| placed.start < end && classes.contains(&problem.class_of[placed.node]);
        let is_below = |&job: &usize| {
            problem.jobs[job].job.deadline.is_none()
                && rank(job) > level
                && state.placed[job]
                    .iter()
                    .any(|placed| !placed.task.is_shared_cache() && is_in_the_way(placed))
        };
        let below: Vec<usize> = (0..problem.jobs.len()).filter(is_below).collect();
        if below.is_empty() {
            continue;
        }
        group.iter().zip(before).for_each(|(&job, count)| state.unbook_after(job, count));
        let lifted: Vec<(usize, Vec<Placed>)> =
            below.into_iter().map(|job| (job, lift(state, job, is_in_the_way))).collect();
        in_turns(state, &group);
        for (job, places) in lifted {
            put_back(state, job, &places);
            if is_open(state, job) {
                wait(&mut waiting, job);
            }
        }
    }
}

/// Removes and returns the frames of a job for whose places this holds, with all their parts.
fn lift(state: &mut State, job: usize, is_wanted: impl Fn(&Placed) -> bool) -> Vec<Placed> {
    let lifted = state.with_other_parts(job, |placed| !placed.task.is_shared_cache() && is_wanted(placed));
    state.unbook_all(job, &lifted);
    state.kept[job] = state.placed[job].len();
    lifted
}

/// Gives frames that were lifted their places back, where these are free.
fn put_back(state: &mut State, job: usize, lifted: &[Placed]) {
    let is_taken = |placed: &Placed| !state.lanes[placed.node].is_free(placed.start, placed.end);
    let taken: BTreeSet<Option<i64>> =
        lifted.iter().filter(|&placed| is_taken(placed)).map(|placed| placed.task.frame()).collect();
    for &placed in lifted.iter().filter(|placed| !taken.contains(&placed.task.frame())) {
        state.book(job, placed);
    }
    state.kept[job] = state.placed[job].len();
}

fn is_open(state: &State, job: usize) -> bool {
    !state.is_kept(job)
}

/// Removes and returns the job's tasks that end after its deadline, with the other parts of their frames. All
/// its tasks go if the shared cache is late.
fn move_what_is_late(state: &mut State, job: usize) -> Vec<Placed> {
    let Some(deadline) = state.problem.jobs[job].job.deadline else { return Vec::new() };
    let is_late = |placed: &Placed| placed.end > deadline;
    let cache_moves = state.placed[job].iter().any(|placed| placed.task.is_shared_cache() && is_late(placed));
    let moving = state.with_other_parts(job, |placed| cache_moves || is_late(placed));
    state.unbook_all(job, &moving);
    state.kept[job] = state.placed[job].len();
    moving
}

/// Tries to place a job in the time of one other job, which is then placed anew. Accepts the result if the
/// other job is still in time, or all placed if it has no deadline. A job of higher priority may also push
/// the other past its deadline.
fn make_way(state: &mut State, job: usize) -> bool {
    let problem = state.problem;
    let work = &problem.jobs[job];
    let Some(deadline) = work.job.deadline else { return false };
    let release = work.release(problem.input.now);
    let mut others: Vec<(bool, Reverse<i64>, usize)> = (0..problem.jobs.len())
        .filter(|&other| other != job)
        .filter(|&other| {
            state.placed[other].iter().any(|placed| {
                placed.start < deadline
                    && placed.end > release
                    && work.classes.contains(&problem.class_of[placed.node])
            })
        })
        .map(|other| {
            let slack = problem.jobs[other]
                .job
                .deadline
                .map_or(i64::MAX, |end| end.saturating_sub(state.finish(other)));
            (problem.jobs[other].job.deadline.is_some(), Reverse(slack), other)
        })
        .collect();
    others.sort_unstable();
    others.into_iter().take(MOST_ASKED).any(|(.., other)| {
        let before = [job, other].map(|of| (of, state.placed[of].clone(), state.kept[of]));
        let makes_way = takes_time_of(state, job, other, (release, deadline));
        if !makes_way {
            for (of, placed, kept) in before {
                state.restore(of, placed);
                state.kept[of] = kept;
            }
        }
        makes_way
    })
}

/// Places a job by its deadline in the time of another, which is then placed anew. Returns whether the result
/// is acceptable; see [`make_way`].
fn takes_time_of(state: &mut State, job: usize, other: usize, (release, deadline): (i64, i64)) -> bool {
    let problem = state.problem;
    let (work, asked) = (&problem.jobs[job], problem.jobs[other].job);
    // Only frames before this job's deadline on nodes that it can use are lifted.
    let lifted = lift(state, other, |placed| {
        placed.start < deadline
            && placed.end > release
            && work.classes.contains(&problem.class_of[placed.node])
    });
    if !place_in_time(state, job) {
        return false;
    }
    put_back(state, other, &lifted);
    if asked.deadline.is_some() && place_in_time(state, other) {
        return true;
    }
    let outranks = work.job.priority > asked.priority;
    if asked.deadline.is_some() && !outranks {
        return false;
    }
    as_early_as_possible(state, other);
    outranks || state.is_kept(other)
}

/// Promises that were kept and now break, each with a rescue.
fn at_risk(input: &Input, old: &Plan, new: &Plan) -> Result<Vec<AtRisk>, InputError> {
    let was_kept = |job: u64| old.job(job).is_none_or(|before| before.verdict.is_kept());
    let breaks = |entry: &&JobPlan| !entry.verdict.is_kept() && was_kept(entry.job);
    let late: Vec<&JobPlan> = new.jobs.iter().filter(breaks).collect();
    let jobs: Vec<u64> = late.iter().map(|entry| entry.job).collect();
    let rescues = rescues(input, new, &jobs)?;
    let with_rescue = late.into_iter().zip(rescues);
    Ok(with_rescue
        .map(|(entry, rescue)| AtRisk { job: entry.job, finish: entry.verdict.finish(), rescue })
        .collect())
}

/// A frame known to end after its job's deadline breaks the promise, whatever the plan.
fn late_by_fact(input: &Input, old: &Plan, new: &Plan, event: &Event) -> Option<AtRisk> {
    let Event::Takes { job, until, .. } = event else { return None };
    let deadline = find(input, *job).ok()?.deadline.filter(|deadline| until > deadline)?;
    let was_kept = old.job(*job).is_some_and(|entry| entry.verdict.is_kept());
    let is_known = new.job(*job).is_none_or(|entry| !entry.verdict.is_kept());
    let change = Change::Later { job: *job, by: until.saturating_sub(deadline) };
    let rescue = Some(Rescue { change, added_cost: 0, finish: *until });
    (was_kept && !is_known).then_some(AtRisk { job: *job, finish: Some(*until), rescue })
}
