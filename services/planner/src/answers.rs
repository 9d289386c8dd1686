//! Questions about a plan: is a job possible, at what price, what would a change do, and what would help.
//!
//! Questions about one job keep the bookings of all others, since these were promised. Those without a
//! deadline make way, as they do in a plan. Questions about the farm make a new plan.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::model::{
    Confidence, Division, FixedBooking, Input, InputError, Interval, Job, JobPlan, Node, Plan, Verdict,
};
use crate::schedule::plan;

const MINUTE: i64 = 60_000_000;

/// A job at one confidence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outlook {
    /// How sure.
    pub confidence: Confidence,
    /// Whether and when it is done.
    pub verdict: Verdict,
    /// Its cost, micro-units.
    pub cost: i64,
    /// Lower bound on its cost, micro-units.
    pub cost_bound: i64,
}

/// A deadline and its price.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Offer {
    /// The deadline.
    pub deadline: i64,
    /// When the job would be done.
    pub finish: i64,
    /// Its cost, micro-units.
    pub cost: i64,
    /// Lower bound on its cost, micro-units.
    pub cost_bound: i64,
}

/// A hypothetical change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Change {
    /// Nodes are added.
    MoreNodes {
        /// The node that they copy.
        like: u64,
        /// How many.
        count: u32,
    },
    /// A node is gone.
    NodeGone {
        /// The node.
        node: u64,
        /// From this instant on.
        from: i64,
    },
    /// A deadline moves.
    Later {
        /// The job.
        job: u64,
        /// Microseconds later; negative for earlier.
        by: i64,
    },
    /// A job's confidence changes.
    Confidence {
        /// The job.
        job: u64,
        /// The new confidence.
        confidence: Confidence,
    },
    /// A job loses its deadline, so that others can have its time.
    MakeWay {
        /// The job.
        job: u64,
    },
    /// The frames of a job may be divided. Frames that must have a number of parts keep it.
    Parts {
        /// The job.
        job: u64,
        /// The most parts of a frame.
        parts: u32,
    },
    /// A job is added.
    NewJob {
        /// The job.
        job: Box<Job>,
    },
}

/// The effect of a change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Effect {
    /// The change.
    pub change: Change,
    /// Change of the cost of all jobs together, micro-units.
    pub added_cost: i64,
    /// Jobs that keep their deadline only with the change.
    pub saved: Vec<u64>,
    /// Jobs that keep their deadline only without the change.
    pub broken: Vec<u64>,
    /// Jobs that end later, and by how many microseconds.
    pub pushed_back: Vec<(u64, i64)>,
    /// Jobs that end earlier, and by how many microseconds.
    pub brought_forward: Vec<(u64, i64)>,
    /// When each job ends, for jobs with a booking for every task.
    pub ends: Vec<(u64, i64)>,
}

impl Effect {
    /// Jobs whose end moves or whose deadline breaks, with the microseconds by which they end later. 0 for a
    /// job that no longer ends.
    pub fn moved(&self) -> BTreeMap<u64, i64> {
        let mut moved: BTreeMap<u64, i64> = self.broken.iter().map(|&job| (job, 0)).collect();
        moved.extend(self.pushed_back.iter().copied());
        moved.extend(self.brought_forward.iter().map(|&(job, by)| (job, by.saturating_neg())));
        moved
    }

    /// When a job would end. `None` if never.
    pub fn end(&self, job: u64) -> Option<i64> {
        self.ends.iter().find(|&&(other, _)| other == job).map(|&(_, end)| end)
    }
}

/// Verdict and cost of the job at P50, P80 and P95.
///
/// # Errors
/// If the input is invalid or has no such job.
pub fn outlook(input: &Input, job: u64) -> Result<Vec<Outlook>, InputError> {
    let around = others_fixed(input, job, find(input, job)?.deadline.is_some())?;
    [Confidence::P50, Confidence::P80, Confidence::P95]
        .into_iter()
        .map(|confidence| {
            let mut asked = around.clone();
            own_job(&mut asked, job)?.confidence = confidence;
            let found = plan(&asked)?;
            let entry = entry(&found, job)?;
            Ok(Outlook {
                confidence,
                verdict: entry.verdict.clone(),
                cost: entry.cost,
                cost_bound: found.cost_bound,
            })
        })
        .collect()
}

/// The job's cost over its deadline, from the earliest end on, in at most `points` offers. The cost never
/// rises with the deadline, since an earlier plan also meets a later deadline.
///
/// # Errors
/// If the input is invalid or has no such job.
pub fn curve(input: &Input, job: u64, points: u32) -> Result<Vec<Offer>, InputError> {
    let around = others_fixed(input, job, true)?;
    let Some((release, soonest)) = soonest(&around, job)? else { return Ok(Vec::new()) };
    let span = soonest.saturating_sub(release).max(MINUTE);
    let mut offers: Vec<Offer> = Vec::new();
    for point in 0..points {
        // From one to eight times the shortest time. Quadratic, since the cost changes most at the short end.
        let part = i128::from(point) * i128::from(point) * 7;
        let steps = i128::from(points.saturating_sub(1).max(1));
        let more = i64::try_from(i128::from(span) * part / (steps * steps)).unwrap_or(i64::MAX);
        let deadline = soonest.saturating_add(more);
        let Some(mut offer) = offer(&around, job, deadline)? else { continue };
        if let Some(before) = offers.last() {
            if before.cost < offer.cost {
                offer = Offer { deadline, cost_bound: offer.cost_bound, ..before.clone() };
            }
            offer.cost_bound = offer.cost_bound.min(before.cost_bound);
        }
        offers.push(offer);
    }
    Ok(offers)
}

/// The earliest deadline that the budget allows, to the minute. `None` if no tested deadline is cheap enough.
///
/// # Errors
/// If the input is invalid or has no such job.
pub fn earliest_for_budget(input: &Input, job: u64, budget: i64) -> Result<Option<Offer>, InputError> {
    let around = others_fixed(input, job, true)?;
    let Some((release, soonest)) = soonest(&around, job)? else { return Ok(None) };
    let within = |deadline| -> Result<Option<Offer>, InputError> {
        Ok(offer(&around, job, deadline)?.filter(|offer| offer.cost <= budget))
    };
    if let Some(first) = within(soonest)? {
        return Ok(Some(first));
    }
    let span = soonest.saturating_sub(release).max(MINUTE);
    let (mut too_early, mut best) = (soonest, None);
    for doubling in 1..=10 {
        let deadline = soonest.saturating_add(span.saturating_mul(1 << doubling));
        best = within(deadline)?;
        if best.is_some() {
            break;
        }
        too_early = deadline;
    }
    while let Some(found) = &best
        && found.deadline.saturating_sub(too_early) > MINUTE
    {
        let middle = too_early + (found.deadline - too_early) / 2;
        match within(middle)? {
            Some(better) => best = Some(better),
            None => too_early = middle,
        }
    }
    Ok(best)
}

/// The effect of a change, from new plans without and with it.
///
/// # Errors
/// If the input is invalid, before or after the change.
pub fn what_if(input: &Input, change: &Change) -> Result<Effect, InputError> {
    let before = plan(input)?;
    let after = plan(&changed(input, change)?)?;
    Ok(effect(change, &before, &after))
}

/// Up to three changes, cheapest first, that let the job keep its deadline, possibly a later one. No other
/// kept deadline may break. Empty if the job keeps its deadline already.
///
/// # Errors
/// If the input is invalid or has no such job.
pub fn ways_out(input: &Input, job: u64) -> Result<Vec<Effect>, InputError> {
    const MOST_NODES: u32 = 64;
    const MOST_PARTS: u32 = 64;
    let before = plan(input)?;
    let verdict = &entry(&before, job)?.verdict;
    if verdict.is_kept() {
        return Ok(Vec::new());
    }
    let asked = find(input, job)?;
    let mut found: Vec<Effect> = Vec::new();
    let mut consider = |change: Change| -> Result<bool, InputError> {
        let after = plan(&changed(input, &change)?)?;
        let effect = effect(&change, &before, &after);
        let helps = entry(&after, job)?.verdict.is_kept() && effect.broken.is_empty();
        if helps {
            found.push(effect);
        }
        Ok(helps)
    };
    if let Some(finish) = verdict.finish()
        && let Some(deadline) = asked.deadline
    {
        let by = finish.saturating_sub(deadline);
        consider(Change::Later { job, by: by.saturating_add(MINUTE - 1) / MINUTE * MINUTE })?;
    }
    for confidence in [Confidence::P80, Confidence::P50] {
        if confidence < asked.confidence && consider(Change::Confidence { job, confidence })? {
            break;
        }
    }
    // Without a known overhead, frames cannot be divided.
    let most = asked.frames.iter().map(|frame| frame.division.most()).min().unwrap_or(MOST_PARTS);
    let mut parts = if asked.part_overhead > 0 { most.saturating_mul(2) } else { u32::MAX };
    while parts <= MOST_PARTS && !consider(Change::Parts { job, parts })? {
        parts *= 2;
    }
    for like in nodes_to_add(input, &before, asked) {
        let mut count = 1;
        while count <= MOST_NODES && !consider(Change::MoreNodes { like, count })? {
            count *= 2;
        }
    }
    for other in jobs_to_push(input, &before, asked) {
        consider(Change::MakeWay { job: other })?;
    }
    found.sort_by_key(|effect| effect.added_cost);
    found.truncate(3);
    Ok(found)
}

/// One node of each of up to three kinds that could help: first those that the proof calls scarce, then the
/// cheapest for the work.
fn nodes_to_add(input: &Input, plan: &Plan, job: &Job) -> Vec<u64> {
    let short: Vec<u64> =
        plan.infeasible.iter().flat_map(|i| &i.short).flat_map(|s| s.nodes.iter().copied()).collect();
    let mut able: Vec<&Node> = input.nodes.iter().filter(|node| node.speed_of(job.class) > 0).collect();
    able.sort_by_key(|node| (!short.contains(&node.id), node.price_of_work(job.class), node.id));
    kinds(able, job.class, 3).iter().map(|node| node.id).collect()
}

/// The first node of each kind, at most `most`. A kind is a speed for this class of work and an hourly price.
pub fn kinds<'a>(nodes: impl IntoIterator<Item = &'a Node>, class: u32, most: usize) -> Vec<&'a Node> {
    let terms = |node: &Node| (node.speed_of(class), node.price_per_hour);
    let mut kinds: Vec<&Node> = Vec::new();
    for node in nodes {
        if kinds.len() < most && !kinds.iter().any(|other| terms(other) == terms(node)) {
            kinds.push(node);
        }
    }
    kinds
}

/// Up to four jobs with deadlines that compete with this job, least important first.
fn jobs_to_push(input: &Input, plan: &Plan, job: &Job) -> Vec<u64> {
    let competes = |other: &&Job| {
        other.id != job.id
            && other.deadline.is_some()
            && plan.infeasible.as_ref().is_none_or(|infeasible| infeasible.jobs.contains(&other.id))
    };
    let mut others: Vec<&Job> = input.jobs.iter().filter(competes).collect();
    others.sort_by_key(|other| (other.priority, other.weight, std::cmp::Reverse(other.deadline), other.id));
    others.iter().take(4).map(|other| other.id).collect()
}

/// Applies the change to the input.
///
/// # Errors
/// If the change names a node or job that does not exist.
pub fn changed(input: &Input, change: &Change) -> Result<Input, InputError> {
    let mut new = input.clone();
    match change {
        Change::MoreNodes { like, count } => {
            let model = node(input, *like)?.clone();
            let first = input.nodes.iter().map(|node| node.id).max().map_or(0, |id| id.saturating_add(1));
            for id in (first..).take(*count as usize) {
                new.nodes.push(Node { id, name: format!("{} more {id}", model.name), ..model.clone() });
            }
        }
        Change::NodeGone { node: gone, from } => {
            node(input, *gone)?;
            let closed = Interval { start: *from, end: None };
            new.nodes
                .iter_mut()
                .filter(|node| node.id == *gone)
                .for_each(|node| node.maintenance.push(closed));
        }
        Change::Later { job, by } => {
            let job = own_job(&mut new, *job)?;
            job.deadline = job.deadline.map(|deadline| deadline.saturating_add(*by));
        }
        Change::Confidence { job, confidence } => own_job(&mut new, *job)?.confidence = *confidence,
        Change::MakeWay { job } => own_job(&mut new, *job)?.deadline = None,
        Change::Parts { job, parts } => {
            for frame in &mut own_job(&mut new, *job)?.frames {
                if frame.division.allows(1) && frame.division.most() < *parts {
                    frame.division = Division::UpTo(*parts);
                }
            }
        }
        Change::NewJob { job } => new.jobs.push((**job).clone()),
    }
    Ok(new)
}

/// Compares the plans before and after a change.
pub fn effect(change: &Change, before: &Plan, after: &Plan) -> Effect {
    let mut effect = Effect {
        change: change.clone(),
        added_cost: after.cost.saturating_sub(before.cost),
        saved: Vec::new(),
        broken: Vec::new(),
        pushed_back: Vec::new(),
        brought_forward: Vec::new(),
        ends: after.jobs.iter().filter_map(|entry| Some((entry.job, entry.verdict.finish()?))).collect(),
    };
    for old in &before.jobs {
        let Some(new) = after.job(old.job) else { continue };
        match (old.verdict.is_kept(), new.verdict.is_kept()) {
            (true, false) => effect.broken.push(old.job),
            (false, true) => effect.saved.push(old.job),
            _ => {}
        }
        if let Some((old_end, new_end)) = old.verdict.finish().zip(new.verdict.finish()) {
            match new_end.saturating_sub(old_end) {
                later @ 1.. => effect.pushed_back.push((old.job, later)),
                0 => {}
                earlier => effect.brought_forward.push((old.job, earlier.saturating_neg())),
            }
        }
    }
    effect
}

/// The input with this job alone. The others are fixed bookings, from the plan of all of them. Jobs without a
/// deadline get the time that is left: they are not there for a job that is asked about `by_deadline`, unless
/// their priority is higher.
fn others_fixed(input: &Input, job: u64, by_deadline: bool) -> Result<Input, InputError> {
    let own = find(input, job)?;
    let mut around = Input { movable: Vec::new(), ..input.clone() };
    around.jobs.retain(|other| other.id == job);
    if input.jobs.len() == around.jobs.len() {
        return Ok(around);
    }
    let stays = |other: &&Job| {
        other.id != job && !(by_deadline && other.deadline.is_none() && other.priority <= own.priority)
    };
    let staying: BTreeSet<u64> = input.jobs.iter().filter(stays).map(|other| other.id).collect();
    for booking in plan(input)?.bookings.iter().filter(|booking| staying.contains(&booking.job)) {
        around.fixed.push(FixedBooking {
            node: booking.node,
            start: booking.start,
            end: booking.end,
            job: Some(booking.job),
        });
    }
    Ok(around)
}

fn soonest(around: &Input, job: u64) -> Result<Option<(i64, i64)>, InputError> {
    let mut asked = around.clone();
    let own = own_job(&mut asked, job)?;
    (own.deadline, own.budget) = (None, None);
    let release = own.release.max(around.now);
    Ok(entry(&plan(&asked)?, job)?.verdict.finish().map(|finish| (release, finish)))
}

/// The job's price for this deadline. `None` if it cannot be kept.
fn offer(around: &Input, job: u64, deadline: i64) -> Result<Option<Offer>, InputError> {
    let mut asked = around.clone();
    own_job(&mut asked, job)?.deadline = Some(deadline);
    let found = plan(&asked)?;
    let entry = entry(&found, job)?;
    let kept = entry.verdict.finish().filter(|_| entry.verdict.is_kept());
    Ok(kept.map(|finish| Offer { deadline, finish, cost: found.cost, cost_bound: found.cost_bound }))
}

pub(crate) fn node(input: &Input, id: u64) -> Result<&Node, InputError> {
    input.nodes.iter().find(|node| node.id == id).ok_or(InputError::UnknownEvent { what: "node", id })
}

pub(crate) fn find(input: &Input, id: u64) -> Result<&Job, InputError> {
    input.jobs.iter().find(|job| job.id == id).ok_or(InputError::UnknownEvent { what: "job", id })
}

pub(crate) fn own_job(input: &mut Input, id: u64) -> Result<&mut Job, InputError> {
    input.jobs.iter_mut().find(|job| job.id == id).ok_or(InputError::UnknownEvent { what: "job", id })
}

fn entry(plan: &Plan, id: u64) -> Result<&JobPlan, InputError> {
    plan.job(id).ok_or(InputError::UnknownEvent { what: "job", id })
}
