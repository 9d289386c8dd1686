//! Plans the farm with as few moves as possible, and breaks no promise that can be kept. Pure.
//!
//! 1. Valid bookings stay. Other frames are placed around them at the least cost in time. Failing that, one
//!    other job makes way (`planner::mend`).
//! 2. If a promise still breaks, or a new job would be late, everything is planned from scratch. That plan is
//!    taken if it keeps more deadlines.
//! 3. Jobs without a deadline are promised only their turn. A new job of a disadvantaged project reorders all
//!    of them, by what each project had for its share.

use std::collections::{BTreeMap, BTreeSet};

use forelight_planner as planner;
use forelight_planner::{AtRisk, Booking, Rescue};
use forelight_protocol::{
    BudgetHold, Job, JobId, JobVerdict, Money, Needs, NodeId, Promise, Timestamp, Verdict,
};
use forelight_store::{FinishSpread, JobOutlook, NewBooking, NewJobPlan};

use super::AdvanceError;
use super::budget_holds::budget_holds;
use super::effects::{all_nodes, duration};
use super::farm::{Asked, Farm, with_spent};
use super::numbers::frame_part;
use super::risks::{Risk, risks};
use super::waits::waits;

/// With more waiting frames than this, whole plans are made the quick way.
const LARGE: usize = 5_000;
/// A frame has moved if its start shifts by more than this (one minute, in microseconds) and a quarter of its
/// length.
pub(crate) const STILL: i64 = 60_000_000;
/// A verdict names serial time of frames from two seconds on, in microseconds.
const MUCH_SERIAL_TIME: i64 = 2_000_000;
/// Most jobs for which one plan looks for ways out.
const MOST_HELPED: usize = 3;

#[derive(Debug)]
pub(crate) struct Settled {
    pub plan: planner::Plan,
    pub jobs: Vec<NewJobPlan>,
    pub outlooks: Vec<(JobId, JobOutlook)>,
    /// How the end of all bookings varies.
    pub finish: Option<FinishSpread>,
}

#[derive(Debug)]
pub(crate) enum Unsettled {
    Refused(Vec<planner::Violation>),
    Failed(AdvanceError),
}

impl<E: Into<AdvanceError>> From<E> for Unsettled {
    fn from(error: E) -> Self {
        Unsettled::Failed(error.into())
    }
}

/// Makes a plan. `fresh` is the place of a job without bookings.
pub(crate) fn settle(farm: &Farm, fresh: Option<usize>) -> Result<Settled, Unsettled> {
    let standing = what_stays(farm, fresh);
    let (plan, at_risk) = least_moved(farm, &standing, fresh)?;
    let whole = farm.with_standing(&standing);
    planner::verify(&whole, &plan).map_err(Unsettled::Refused)?;
    let (risks, finish) = risks(farm, &plan)?;
    let before = by_job(&farm.standing, farm.jobs.len());
    let booked = by_job(&farm.booked, farm.jobs.len());
    let after = by_job(&plan.bookings, farm.jobs.len());
    let waits = waits(farm, &plan, &after)?;
    let holds = budget_holds(farm, &plan, &farm.input.fixed);
    let verdicts: Vec<JobVerdict> =
        holds.iter().enumerate().map(|(job, hold)| verdict(farm, &plan, job, hold.as_ref())).collect();
    let says_new = |(job, said): (usize, &JobVerdict)| {
        let asked = &farm.jobs[job];
        let says_new = asked.job.verdict.as_ref().is_none_or(|before| before.verdict != said.verdict);
        let is_asked = fresh == Some(job) || asked.has_new_terms;
        if asked.held {
            // Its bookings stay until another job needs the time. It goes on there when it is let go.
            return is_asked;
        }
        let is_resized = is_resized(&booked[job], &after[job]);
        is_asked
            || says_new
            || asked.factor != asked.factor_before
            || is_resized
            || has_moved(&before[job], &after[job])
    };
    let news: Vec<bool> = verdicts.iter().enumerate().map(says_new).collect();
    let booked_anew = make_way(&farm.booked, &plan.bookings, news);
    let mut jobs = Vec::new();
    let mut outlooks = Vec::new();
    let mut helped = 0;
    for ((job, mut said), budget_hold) in verdicts.into_iter().enumerate().zip(holds) {
        let asked = &farm.jobs[job];
        let lacks_money = lacks_money(asked, end(farm, &plan, job), budget_hold.as_ref());
        let Risk { probability, finish } = risks[job].given_money(lacks_money);
        let promise = promise(farm, &plan, (&at_risk, budget_hold.as_ref()), probability, job);
        let waits = waits.get(&job).cloned();
        let outlook = JobOutlook { waits, promise, finish, probability, budget_hold, takes: None };
        outlooks.push((asked.job.id, outlook));
        if !booked_anew[job] {
            continue;
        }
        if said.verdict != Verdict::OnTime && helped < MOST_HELPED && !asked.held && !lacks_money {
            helped += 1;
            let within_budget = said.verdict != Verdict::OverBudget;
            said.ways_out = farm.ways_out(job, &plan.bookings, within_budget)?;
        }
        let of_frames = after[job].iter().filter(|booking| !booking.task.is_shared_cache());
        let bookings = of_frames.map(|booking| own_booking(farm, booking)).collect::<Option<_>>();
        let bookings = bookings.ok_or_else(|| {
            AdvanceError::Hopeless("the plan books a node or frame that does not exist".to_owned())
        })?;
        let (begun, factor, terms) = (asked.begun.clone(), asked.factor, asked.terms);
        jobs.push(NewJobPlan { verdict: said, bookings, begun, factor, terms });
    }
    Ok(Settled { plan, jobs, outlooks, finish })
}

/// Bookings that stay unless needed: normally all. A job with new terms is placed anew. If a new job without
/// a deadline is due before others, then all such jobs of its priority or lower take turns anew.
fn what_stays(farm: &Farm, fresh: Option<usize>) -> Vec<Booking> {
    let stays = |booking: &&Booking| !farm.jobs[booking.job as usize].has_new_terms;
    let standing: Vec<Booking> = farm.standing.iter().filter(stays).copied().collect();
    let fresh = fresh.map(|fresh| &farm.input.jobs[fresh]).filter(|fresh| fresh.deadline.is_none());
    let Some(fresh) = fresh else { return standing };
    let takes_turns = |booking: &Booking| {
        let other = &farm.input.jobs[booking.job as usize];
        other.deadline.is_none() && other.priority <= fresh.priority
    };
    let goes_before = |booking: &Booking| {
        let other = &farm.input.jobs[booking.job as usize];
        takes_turns(booking) && (other.project != fresh.project || other.priority < fresh.priority)
    };
    if !standing.iter().any(goes_before) {
        return standing;
    }
    standing.into_iter().filter(|booking| !takes_turns(booking)).collect()
}

/// The plan with fewest moves, unless another one keeps more deadlines. Also the promises that it breaks.
fn least_moved(
    farm: &Farm,
    standing: &[Booking],
    fresh: Option<usize>,
) -> Result<(planner::Plan, Vec<AtRisk>), AdvanceError> {
    let mended = planner::mend(&farm.input, &promises(farm, standing))?;
    let broken = |plan: &planner::Plan| {
        let misses = |job: usize| !farm.jobs[job].is_kept(end(farm, plan, job));
        let promised = (0..farm.jobs.len()).filter(|&job| farm.jobs[job].binds() && misses(job)).count();
        // A deadline that was just asked for counts like that of a new job.
        let asked_for =
            (0..farm.jobs.len()).filter(|&job| fresh == Some(job) || farm.jobs[job].has_new_terms);
        let asked_for = asked_for.filter(|&job| !farm.jobs[job].held);
        (promised, asked_for.into_iter().any(misses))
    };
    let found = broken(&mended.plan);
    if found == (0, false) {
        return Ok((mended.plan, mended.at_risk));
    }
    let whole = farm.with_standing(standing);
    let open: usize = farm.input.jobs.iter().map(|job| job.frames.len() - job.done.len()).sum();
    let anew = if open > LARGE { planner::plan_quickly(&whole)? } else { planner::plan(&whole)? };
    if broken(&anew) >= found {
        return Ok((mended.plan, mended.at_risk));
    }
    // Remaining broken promises are mended if possible, else reported at risk.
    let mended = planner::mend(&farm.input, &promises(farm, &anew.bookings))?;
    Ok((mended.plan, mended.at_risk))
}

fn promises(farm: &Farm, standing: &[Booking]) -> planner::Plan {
    let promised = |job: usize| planner::JobPlan {
        job: job as u64,
        verdict: if farm.jobs[job].binds() {
            planner::Verdict::Feasible { finish: farm.input.now, slack: 0 }
        } else {
            planner::Verdict::Unplaced { frames: Vec::new(), shared_cache: false }
        },
        cost: 0,
        within_budget: None,
        bound: planner::Bound::default(),
    };
    let jobs = (0..farm.jobs.len()).map(promised).collect();
    planner::Plan { bookings: standing.to_vec(), jobs, ..planner::Plan::default() }
}

pub(crate) fn end(farm: &Farm, plan: &planner::Plan, job: usize) -> Option<i64> {
    farm.jobs[job].finish(plan.job(job as u64)?.verdict.finish())
}

fn own_booking(farm: &Farm, booking: &Booking) -> Option<NewBooking> {
    let node: NodeId = farm.nodes.get(usize::try_from(booking.node).ok()?)?.id;
    Some(NewBooking {
        frame: frame_part(booking.task)?,
        node,
        start: Timestamp::from_micros(booking.start),
        end: Timestamp::from_micros(booking.end),
    })
}

/// The jobs to book anew: those with changes, and those whose old bookings overlap with new ones on a node.
/// The latter have hardly moved (see [`stayed`]), but bookings of a node must not overlap.
fn make_way(booked: &[Booking], planned: &[Booking], mut anew: Vec<bool>) -> Vec<bool> {
    loop {
        let mut taken: BTreeMap<(u64, i64), i64> = BTreeMap::new();
        for booking in planned.iter().filter(|booking| anew[booking.job as usize]) {
            taken.insert((booking.node, booking.start), booking.end);
        }
        // Bookings of one plan do not overlap, so only the last that starts before this one's end can reach
        // into it.
        let lies_on_one = |one: &Booking| {
            let before = taken.range((one.node, i64::MIN)..(one.node, one.end)).next_back();
            before.is_some_and(|(_, &end)| end > one.start)
        };
        let in_the_way: BTreeSet<usize> = booked
            .iter()
            .filter(|one| !anew[one.job as usize] && lies_on_one(one))
            .map(|one| one.job as usize)
            .collect();
        if in_the_way.is_empty() {
            return anew;
        }
        in_the_way.into_iter().for_each(|job| anew[job] = true);
    }
}

/// The bookings of each of so many jobs, in their order.
fn by_job(bookings: &[Booking], jobs: usize) -> Vec<Vec<&Booking>> {
    let mut of_job = vec![Vec::new(); jobs];
    for booking in bookings {
        of_job[booking.job as usize].push(booking);
    }
    of_job
}

/// Whether the bookings of a job differ, beyond the tolerance.
fn has_moved(before: &[&Booking], after: &[&Booking]) -> bool {
    let after: BTreeMap<planner::Task, &Booking> =
        after.iter().map(|booking| (booking.task, *booking)).collect();
    let still = |one: &&Booking| after.get(&one.task).is_some_and(|other| stayed(one, other));
    before.len() != after.len() || !before.iter().all(still)
}

/// Whether what waits of a job takes at least a tenth more or less time than it is booked for.
fn is_resized(booked: &[&Booking], after: &[&Booking]) -> bool {
    let lengths: BTreeMap<planner::Task, i64> =
        booked.iter().map(|one| (one.task, one.end - one.start)).collect();
    let both = after.iter().filter_map(|one| Some((*lengths.get(&one.task)?, one.end - one.start)));
    let (before, now) =
        both.fold((0i64, 0i64), |sum, one| (sum.0.saturating_add(one.0), sum.1.saturating_add(one.1)));
    now.abs_diff(before) > before.unsigned_abs() / 10
}

/// Whether a task stayed in place, within the tolerance.
pub(crate) fn stayed(before: &Booking, after: &Booking) -> bool {
    let by = after.start.saturating_sub(before.start).saturating_abs();
    after.node == before.node && by <= STILL.max(before.end.saturating_sub(before.start) / 4)
}

/// Whether a job that ends in time in the plan misses its deadline, since its project's budget will hold it.
pub(super) fn lacks_money(asked: &Asked, planned: Option<i64>, hold: Option<&BudgetHold>) -> bool {
    planned.is_some() && asked.is_kept(planned) && !asked.is_kept(end_with(hold, planned))
}

/// The end of a job that ends at `planned` in the plan. `None` if it never ends, or not before somebody raises
/// a budget.
fn end_with(hold: Option<&BudgetHold>, planned: Option<i64>) -> Option<i64> {
    match hold {
        Some(hold) => Some(hold.end(Timestamp::from_micros(planned?))?.micros()),
        None => planned,
    }
}

fn verdict(farm: &Farm, plan: &planner::Plan, job: usize, hold: Option<&BudgetHold>) -> JobVerdict {
    let asked = &farm.jobs[job];
    let entry = plan.job(job as u64);
    let planned = end(farm, plan, job);
    let finish = end_with(hold, planned);
    let lacks_money = lacks_money(asked, planned, hold);
    let over_budget = entry.is_some_and(|entry| entry.within_budget == Some(false));
    let mut reasons = Vec::new();
    let verdict = match (planned, asked.job.deadline) {
        _ if lacks_money => {
            reasons.push(too_little(&asked.job.project));
            if asked.job.deadline.is_some() { Verdict::Late } else { Verdict::OverBudget }
        }
        (None, _) => {
            reasons.push(unplaced(farm, asked.job.needs().as_ref(), entry));
            Verdict::Impossible
        }
        (Some(finish), Some(deadline)) if finish > deadline.micros() => {
            reasons.push(format!("{} after the deadline", duration(finish - deadline.micros())));
            let bound = entry.and_then(|entry| asked.finish(entry.bound.earliest_finish()));
            reasons.push(match bound.filter(|&bound| bound > deadline.micros()) {
                Some(bound) => format!(
                    "no plan can be in time: with {} to itself it ends at {} at the earliest",
                    all_nodes(farm.nodes.len()),
                    Timestamp::from_micros(bound)
                ),
                None if asked.held => held_back(&asked.job),
                None => in_the_way(farm, plan, asked, finish),
            });
            Verdict::Late
        }
        (Some(finish), deadline) => {
            if let Some(deadline) = deadline {
                reasons.push(format!("{} before the deadline", duration(deadline.micros() - finish)));
            }
            if over_budget { Verdict::OverBudget } else { Verdict::OnTime }
        }
    };
    let cost = with_spent(entry.map_or(0, |entry| entry.cost), asked);
    if over_budget && let Some(budget) = asked.job.budget {
        let above = cost.micro_units().saturating_sub(budget.micro_units());
        reasons.push(format!("{} above the budget", Money(above)));
    }
    if asked.factor > 1.0 {
        reasons
            .push(format!("its frames take {:.0} % longer than was forecast", (asked.factor - 1.0) * 100.0));
    } else if asked.factor < 1.0 {
        reasons.push(format!("its frames take {:.0} % less than was forecast", (1.0 - asked.factor) * 100.0));
    }
    let serial = farm.nodes.iter().map(|node| asked.serial_time.on(node.cores)).max().unwrap_or(0);
    if serial >= MUCH_SERIAL_TIME {
        reasons.push(format!("each frame keeps its node {} longer than its CPU time says", duration(serial)));
    }
    JobVerdict {
        job_id: asked.job.id,
        verdict,
        confidence: asked.job.confidence,
        finish: finish.map(Timestamp::from_micros),
        cost: planned.map(|_| cost),
        reasons,
        ways_out: Vec::new(),
    }
}

fn unplaced(farm: &Farm, needs: Option<&Needs>, entry: Option<&planner::JobPlan>) -> String {
    match entry.map(|entry| &entry.verdict) {
        _ if farm.nodes.is_empty() => "there is no node that takes work".to_owned(),
        _ if let Some(needs) = needs
            && !farm.nodes.iter().any(|node| node.has(needs)) =>
        {
            format!("no node that takes work has {needs}")
        }
        Some(planner::Verdict::Unplaced { shared_cache: true, .. }) => NO_ROOM_FOR_CACHE.to_owned(),
        Some(planner::Verdict::Unplaced { frames, .. }) if frames.len() == 1 => {
            "1 frame does not fit into any node's free time".to_owned()
        }
        Some(planner::Verdict::Unplaced { frames, .. }) => {
            format!("{} frames do not fit into any node's free time", frames.len())
        }
        _ => "the plan has no free node for it".to_owned(),
    }
}

/// Reason why a job is late that is held.
pub(crate) fn held_back(job: &Job) -> String {
    if job.paused {
        return "the job is paused: work continues when it is resumed".to_owned();
    }
    format!(
        "the budget of project {} is used up: work continues when it is raised or its next period begins",
        job.project
    )
}

/// Reason why a job will wait for its project's budget. [`BudgetHold`] says more, and is kept up to date.
fn too_little(project: &str) -> String {
    format!("the budget of project {project} does not last for all of its frames")
}

/// Reason why a job has no end whose frames wait for a shared cache.
pub(crate) const NO_ROOM_FOR_CACHE: &str = "its shared cache does not fit into any node's free time";

/// How a reason begins that names other jobs.
pub(crate) const IN_THE_WAY: &str = "what is booked already stands in the way";

/// Reason why a job is late that would be on time alone.
fn in_the_way(farm: &Farm, plan: &planner::Plan, late: &Asked, finish: i64) -> String {
    let before: BTreeSet<u64> = plan
        .bookings
        .iter()
        .filter(|booking| booking.start < finish && farm.jobs[booking.job as usize].job.id != late.job.id)
        .map(|booking| booking.job)
        .chain(farm.input.fixed.iter().filter_map(|fixed| fixed.job))
        .filter(|&job| farm.jobs[job as usize].job.id != late.job.id)
        .collect();
    let names: Vec<&str> =
        before.iter().take(3).map(|&job| farm.jobs[job as usize].job.name.as_str()).collect();
    match (names.len(), before.len()) {
        (0, _) => "its frames do not fit into the nodes' time before it".to_owned(),
        (shown, all) if shown < all => {
            format!("{IN_THE_WAY}: {} and {} more", names.join(", "), all - shown)
        }
        _ => format!("{IN_THE_WAY}: {}", names.join(", ")),
    }
}

/// State of a job's promise. `None` if its deadline was never promised and is not kept.
fn promise(
    farm: &Farm,
    plan: &planner::Plan,
    (at_risk, hold): (&[AtRisk], Option<&BudgetHold>),
    probability: Option<f64>,
    job: usize,
) -> Option<Promise> {
    let asked = &farm.jobs[job];
    let (deadline, probability) = asked.job.deadline.zip(probability)?;
    // A job that is held has no end until it is let go.
    let planned = end(farm, plan, job);
    let finish = end_with(hold, planned).filter(|_| !asked.held);
    let kept = asked.is_kept(finish);
    if !kept && !asked.is_promised() {
        return None;
    }
    let before = asked.job.promise.as_ref().filter(|before| before.kept == kept);
    let rescue = if kept || lacks_money(asked, planned, hold) {
        None
    } else {
        let found = at_risk.iter().find(|risk| risk.job == job as u64).and_then(|risk| risk.rescue.clone());
        // Running frames cannot be planned, so only a later deadline helps.
        let by_time = || {
            let finish = finish?;
            let change =
                planner::Change::Later { job: job as u64, by: finish.saturating_sub(deadline.micros()) };
            Some(Rescue { change, added_cost: 0, finish })
        };
        let found =
            if plan.job(job as u64).is_some_and(|entry| entry.verdict.is_kept()) { by_time() } else { found };
        found.and_then(|Rescue { change, added_cost, finish }| {
            farm.told(&change, added_cost, asked.finish(Some(finish)), true, &[], job)
        })
    };
    Some(Promise {
        kept,
        probability,
        finish: finish.map(Timestamp::from_micros),
        since: before.map_or(Timestamp::from_micros(farm.input.now), |before| before.since),
        rescue,
    })
}

#[cfg(test)]
mod tests;
