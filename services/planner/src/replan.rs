//! When something happens: a new plan that moves as little as it can.

use serde::{Deserialize, Serialize};

use crate::admission::Admission;
use crate::answers::{Change, changed, find, node, own_job};
use crate::bound::{bound, bound_of_all};
use crate::difference::{Difference, difference};
use crate::lane::Prefer;
use crate::model::{
    Booking, Bound, FixedBooking, Input, InputError, Interval, Job, Node, Plan, PlanId, Task,
};
use crate::outcome;
use crate::problem::Problem;
use crate::schedule::{as_early_as_possible, in_turns, place_all};
use crate::state::{Placed, State};

/// Jobs that are asked to make way for one at most.
const MOST_ASKED: usize = 12;

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Event {
    /// A node died, or has to be serviced.
    NodeDown {
        /// The node.
        node: u64,
        /// Since when.
        from: i64,
        /// Until when; none: nobody knows.
        until: Option<i64>,
    },
    /// A node was added.
    NodeUp {
        /// The node.
        node: Box<Node>,
    },
    /// A task turned out to last until this instant.
    Takes {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
        /// When it ends, or ended.
        until: i64,
    },
    /// A job came in.
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
    /// The input as it is now.
    pub input: Input,
    /// The plan; its parent is the old one.
    pub plan: Plan,
    /// What is different.
    pub difference: Difference,
    /// Promises that the old plan kept and this one cannot.
    pub at_risk: Vec<AtRisk>,
}

/// A promise that cannot be kept any more.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AtRisk {
    /// The job.
    pub job: u64,
    /// When it would now end; none if never.
    pub finish: Option<i64>,
    /// The cheapest rescue that was found: a change, and what it costs.
    pub rescue: Option<(Change, i64)>,
}

/// Plans on after an event.
///
/// What is right of the old plan stays. What is not is placed anew at the least cost that keeps its deadline. If that cannot
/// be, other jobs make way, one at a time, if they can keep their own deadlines elsewhere. If that does not
/// help either, the promise is reported as at risk, with the cheapest rescue. No promise is broken in silence.
///
/// # Errors
/// If the input has no meaning before or after the event.
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

/// Plans on from how things stand, whatever happened: as [`replan`], with what is different in the input already. `old` holds the bookings
/// that stand, and its verdicts say which promises there are; a job that it does not name is new.
///
/// # Errors
/// If the input has no meaning.
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
    // The old plan's prices still prove something, only perhaps less.
    let inherited = Admission::none(&problem).with_proof(old.proof.clone());
    let plan = outcome::plan(&state, &inherited, bounds, together, Some(parent));
    let at_risk = at_risk(&input, old, &plan)?;
    let difference = difference(old, &plan);
    drop(state);
    Ok(Replanned { plan, difference, at_risk, input })
}

/// The input after the event, and the tasks whose bookings are facts by it.
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
                // It is a fact now, and no longer a task of the job; a shared cache that is done is a later release.
                let facts: Vec<&Booking> = match task.frame() {
                    // All parts of the shared cache are, with the one.
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
                    Some(number) => {
                        job.done.push(number);
                        vec![booking]
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

/// Places what has no place, and what has one after its deadline, jobs with the earliest deadline first; then those without a deadline, in
/// turns.
fn repair(state: &mut State) {
    let problem = state.problem;
    let open: Vec<usize> = (0..problem.jobs.len()).filter(|&job| is_open(state, job)).collect();
    let has_deadline = |&job: &usize| problem.jobs[job].job.deadline.is_some();
    let (mut promised, mut others): (Vec<usize>, Vec<usize>) = open.into_iter().partition(has_deadline);
    promised.sort_unstable_by_key(|&job| {
        let job = problem.jobs[job].job;
        (job.deadline, std::cmp::Reverse(job.priority), job.id)
    });
    for job in promised {
        let before = (state.missing_tasks(job), state.finish(job));
        let late = move_what_is_late(state, job);
        if place_in_time(state, job) || make_way(state, job) {
            continue;
        }
        as_early_as_possible(state, job);
        if (state.missing_tasks(job), state.finish(job)) >= before {
            // It helped nobody: what was late stays where it was.
            state.unbook_after(job, state.kept[job]);
            late.into_iter().for_each(|placed| state.book(job, placed));
        }
    }
    let priority = |job: usize| problem.jobs[job].job.priority;
    others.sort_unstable_by_key(|&job| (std::cmp::Reverse(priority(job)), problem.jobs[job].job.id));
    for group in others.chunk_by(|&a, &b| priority(a) == priority(b)) {
        in_turns(state, group);
    }
}

fn is_open(state: &State, job: usize) -> bool {
    !state.is_kept(job)
}

/// Frees what a job has after its deadline, so that it can be placed anew; returns that.
fn move_what_is_late(state: &mut State, job: usize) -> Vec<Placed> {
    let Some(deadline) = state.problem.jobs[job].job.deadline else { return Vec::new() };
    let is_late = |placed: &Placed| placed.end > deadline;
    // All frames move with the shared cache.
    let cache_moves = state.placed[job].iter().any(|placed| placed.task.is_shared_cache() && is_late(placed));
    let placed = state.placed[job].iter();
    let moving: Vec<Placed> = placed.filter(|placed| cache_moves || is_late(placed)).copied().collect();
    for &placed in &moving {
        state.unbook(job, placed);
    }
    state.kept[job] = state.placed[job].len();
    moving
}

fn place_in_time(state: &mut State, job: usize) -> bool {
    let before = state.placed[job].len();
    for prefer in [Prefer::Cheap, Prefer::Early] {
        if place_all(state, job, prefer, None) {
            return true;
        }
        state.unbook_after(job, before);
    }
    false
}

/// Lets other jobs make way, one at a time: each is lifted out, this one placed, the other put back; if both are then in time
/// (or placed, where the other has no deadline), or this one has a greater priority, it stays so.
fn make_way(state: &mut State, job: usize) -> bool {
    let problem = state.problem;
    let work = &problem.jobs[job];
    let Some(deadline) = work.job.deadline else { return false };
    let release = work.release(problem.input.now);
    let mut others: Vec<(bool, std::cmp::Reverse<i64>, usize)> = (0..problem.jobs.len())
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
            (problem.jobs[other].job.deadline.is_some(), std::cmp::Reverse(slack), other)
        })
        .collect();
    others.sort_unstable();
    for (has_deadline, _, other) in others.into_iter().take(MOST_ASKED) {
        let mut trial = state.clone();
        // What lies before this job's deadline on nodes that it could use goes; the rest of the other stays.
        let lifted: Vec<Placed> = trial.placed[other]
            .iter()
            .filter(|placed| matches!(placed.task, Task::Frame(_)))
            .filter(|placed| placed.start < deadline && placed.end > release)
            .filter(|placed| work.classes.contains(&problem.class_of[placed.node]))
            .copied()
            .collect();
        lifted.iter().for_each(|&placed| trial.unbook(other, placed));
        trial.kept[other] = trial.placed[other].len();
        if !place_in_time(&mut trial, job) {
            continue;
        }
        // Those of the other whose place is still free go back to it; only the rest moves.
        for &placed in &lifted {
            if trial.lanes[placed.node].is_free(placed.start, placed.end) {
                trial.book(other, placed);
            }
        }
        trial.kept[other] = trial.placed[other].len();
        let outranks = work.job.priority > problem.jobs[other].job.priority;
        if has_deadline && place_in_time(&mut trial, other) {
            *state = trial;
            return true;
        }
        if !has_deadline || outranks {
            as_early_as_possible(&mut trial, other);
            if outranks || trial.is_kept(other) {
                *state = trial;
                return true;
            }
        }
    }
    false
}

/// Promises that were kept and are not any more, each with a rescue.
fn at_risk(input: &Input, old: &Plan, new: &Plan) -> Result<Vec<AtRisk>, InputError> {
    let mut found = Vec::new();
    for entry in new.jobs.iter().filter(|entry| !entry.verdict.is_kept()) {
        let was_kept = old.job(entry.job).is_none_or(|before| before.verdict.is_kept());
        if was_kept {
            let rescue = rescue(input, new, entry.job)?;
            found.push(AtRisk { job: entry.job, finish: entry.verdict.finish(), rescue });
        }
    }
    Ok(found)
}

/// A task that lasts beyond its job's deadline breaks the promise whatever is planned.
fn late_by_fact(input: &Input, old: &Plan, new: &Plan, event: &Event) -> Option<AtRisk> {
    let Event::Takes { job, until, .. } = event else { return None };
    let deadline = find(input, *job).ok()?.deadline.filter(|deadline| until > deadline)?;
    let was_kept = old.job(*job).is_some_and(|entry| entry.verdict.is_kept());
    let is_known = new.job(*job).is_none_or(|entry| !entry.verdict.is_kept());
    let rescue = Some((Change::Later { job: *job, by: until.saturating_sub(deadline) }, 0));
    (was_kept && !is_known).then_some(AtRisk { job: *job, finish: Some(*until), rescue })
}

/// The cheapest of a few changes that let the job be in time around everything else that is booked.
fn rescue(input: &Input, new: &Plan, job: u64) -> Result<Option<(Change, i64)>, InputError> {
    let asked = find(input, job)?;
    let others: Vec<Booking> = new.bookings.iter().filter(|booking| booking.job != job).copied().collect();
    let mut able: Vec<&Node> = input.nodes.iter().filter(|node| node.speed_of(asked.class) > 0).collect();
    able.sort_by_key(|node| {
        (i128::from(node.price_per_hour) * 1_000_000_000 / i128::from(node.speed_of(asked.class)), node.id)
    });
    let cheapest = able.first().map(|node| node.id);
    let fastest = able.iter().max_by_key(|node| (node.speed_of(asked.class), node.id)).map(|node| node.id);
    let mut changes: Vec<Change> = Vec::new();
    for like in [cheapest, fastest].into_iter().flatten() {
        changes.extend([1, 2, 4, 8, 16].map(|count| Change::MoreNodes { like, count }));
    }
    if let (Some(finish), Some(deadline)) =
        (new.job(job).and_then(|entry| entry.verdict.finish()), asked.deadline)
    {
        changes.push(Change::Later { job, by: finish.saturating_sub(deadline) });
    }
    let mut best: Option<(Change, i64)> = None;
    for change in changes {
        let trial = changed(input, &change)?;
        let problem = Problem::new(&trial);
        let admission = Admission::none(&problem);
        let mut state = State::new(&problem, &admission);
        state.keep(&others);
        let Some(index) = problem.job(job) else { continue };
        if !place_in_time(&mut state, index) {
            continue;
        }
        let added = state.cost().saturating_sub(new.cost);
        // A later deadline is no rescue while there is one that keeps this one.
        let keeps = !matches!(change, Change::Later { .. });
        let better = match &best {
            None => true,
            Some((Change::Later { .. }, _)) => true,
            Some((_, least)) => keeps && added < *least,
        };
        if better {
            best = Some((change, added));
        }
    }
    Ok(best)
}
