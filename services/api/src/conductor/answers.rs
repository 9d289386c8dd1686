//! Answers to questions about a job's plan.
//!
//! Questions about the job alone keep the bookings of all others. Questions that may move others plan the
//! whole farm if it is small. Pure except for the clock that limits the time; questions not reached by then
//! are listed.

use std::time::{Duration, Instant};

use forelight_planner as planner;
use forelight_planner::Change;
use forelight_plots as plots;
use forelight_plots::PlotError;
use forelight_protocol::words::{counted, is_or_are};
use forelight_protocol::{
    AccuracyRung, AnswersDoc, BudgetAnswer, JobId, Money, MovedJob, OutlookLine, PlanEffect, PriceOffer,
    Timestamp,
};

use super::AdvanceError;
use super::effects::duration;
use super::farm::{Farm, Snapshot};
use super::qualities::qualities;
use super::quantities::own_confidence;
use super::risks::risk;
use super::settle::{NO_ROOM_FOR_CACHE, end, held_back};
use super::what_if::take_away;

const POINTS: u32 = 13;

const SECOND: i64 = 1_000_000;
const HOUR: i64 = 3600 * SECOND;

/// Number of node kinds for which "one more" is tried.
const KINDS: usize = 3;

#[derive(Clone, Debug, Default)]
pub(crate) struct Question {
    /// Deadline to ask about. If absent, the job's own.
    pub deadline: Option<Timestamp>,
    /// Budget to ask about. If absent, what is left of the job's own.
    pub budget: Option<Money>,
    pub rungs: Vec<AccuracyRung>,
    /// Time limit for the answers. A question already begun is finished.
    pub patience: Duration,
}

/// Answers about a job's plan. `None` if the job has no forecast to plan with.
pub(crate) fn answers(
    mut snapshot: Snapshot,
    job: JobId,
    question: &Question,
) -> Result<Option<AnswersDoc>, AdvanceError> {
    let begun = Instant::now();
    let mut is_held = false;
    if let Some(asked) = snapshot.jobs.iter_mut().find(|asked| asked.job.id == job) {
        asked.job.deadline = question.deadline.or(asked.job.deadline);
        // The answers are of the time when it is let go.
        is_held = std::mem::take(&mut asked.held);
    }
    let farm = Farm::new(&snapshot);
    let Some(place) = farm.place(job) else { return Ok(None) };
    let asking = Asking::new((&snapshot, &farm), place, question.budget)?;
    let mut document = asking.about_its_plan()?;
    if is_held {
        document.why_not.insert(0, held_back(&farm.jobs[place].job));
    }
    asking.about_changes(&mut document, question, &|| begun.elapsed() < question.patience)?;
    Ok(Some(document))
}

/// A job whose plan is asked about.
struct Asking<'a> {
    snapshot: &'a Snapshot,
    farm: &'a Farm,
    job: usize,
    /// The farm around the existing bookings of other jobs.
    around: planner::Input,
    /// The job's plan there.
    plan: planner::Plan,
    finish: Option<i64>,
    budget: Option<Money>,
    affordable: bool,
    /// Whether the plan keeps deadline and budget.
    kept: bool,
}

impl<'a> Asking<'a> {
    fn new(
        (snapshot, farm): (&'a Snapshot, &'a Farm),
        job: usize,
        budget: Option<Money>,
    ) -> Result<Self, AdvanceError> {
        let around = farm.around(job, &farm.standing);
        let plan = planner::plan(&around)?;
        let finish = end(farm, &plan, job);
        let budget = budget.or(farm.input.jobs[job].budget.map(Money));
        let cost = plan.job(job as u64).map(|entry| entry.cost);
        let affordable = cost.is_none_or(|cost| budget.is_none_or(|budget| cost <= budget.micro_units()));
        let kept = farm.jobs[job].is_kept(finish) && affordable;
        Ok(Self { snapshot, farm, job, around, plan, finish, budget, affordable, kept })
    }

    /// Answers what the plan itself says.
    fn about_its_plan(&self) -> Result<AnswersDoc, AdvanceError> {
        let Self { farm, job, around, plan, .. } = self;
        let asked = &farm.jobs[*job];
        let mut document = AnswersDoc {
            job_id: asked.job.id,
            plan_id: None,
            at: Timestamp::from_micros(farm.input.now),
            deadline: asked.job.deadline,
            probability: risk(farm, around, plan, *job)?.probability,
            outlook: outlook(farm, *job, around)?,
            cheapest: None,
            for_budget: None,
            curve: Vec::new(),
            qualities: Vec::new(),
            what_if: Vec::new(),
            pushes_back: Vec::new(),
            why_not: Vec::new(),
            ways_out: Vec::new(),
            left_out: Vec::new(),
        };
        if asked.is_kept(self.finish)
            && let (Some(finish), Some(deadline)) = (self.finish, asked.job.deadline)
        {
            document.cheapest = Some(PriceOffer {
                deadline,
                finish: Timestamp::from_micros(finish),
                cost: Money(plan.cost),
                cost_at_least: Money(plan.cost_bound),
            });
        }
        if !self.kept {
            document.why_not = why_not(farm, around, plan, *job, self.budget);
        }
        Ok(document)
    }

    /// Answers what changes would bring, one question after the other. Those that `there_is_time` leaves out are
    /// listed.
    fn about_changes(
        &self,
        document: &mut AnswersDoc,
        question: &Question,
        there_is_time: &dyn Fn() -> bool,
    ) -> Result<(), AdvanceError> {
        let &Self { snapshot, farm, job, ref around, budget, .. } = self;
        let mut left_out = Vec::new();
        let mut reach = |name: &str| {
            let reached = there_is_time();
            if !reached {
                left_out.push(name.to_owned());
            }
            reached
        };
        let mut limited = farm.clone();
        limited.input.jobs[job].budget = budget.map(Money::micro_units);
        if reach("ways_out") && !self.kept {
            document.ways_out = limited.ways_out(job, &farm.standing, self.affordable)?;
        }
        if reach("for_budget")
            && let Some(budget) = budget
        {
            let offer = planner::earliest_for_budget(around, job as u64, budget.micro_units())?;
            let offer = offer.map(|offer| own_offer(farm, job, &offer));
            document.for_budget = Some(BudgetAnswer { budget, offer });
        }
        if reach("curve") {
            let found = planner::curve(around, job as u64, POINTS)?;
            document.curve = found.iter().map(|offer| own_offer(farm, job, offer)).collect();
        }
        let mut offers = Vec::new();
        let mut is_cut_short = false;
        if reach("qualities") {
            let mut best_first = qualities(&limited, job, &farm.standing, &question.rungs);
            is_cut_short = loop {
                if !there_is_time() {
                    break true;
                }
                let Some(offer) = best_first.next() else { break false };
                offers.push(offer?);
            };
        }
        if reach("pushes_back") {
            document.pushes_back = pushed_back(farm, job)?;
        }
        if reach("what_if") {
            document.what_if = effects(snapshot, farm, job)?;
        }
        if is_cut_short {
            left_out.push("qualities".to_owned());
        }
        if let Some(way) = offers.iter().find_map(|offer| (!self.kept).then(|| offer.way(self.plan.cost))?) {
            document.ways_out.push(way);
            document.ways_out.sort_by_key(|way| way.added_cost);
            document.ways_out.truncate(3);
        }
        document.qualities = offers.into_iter().map(|offer| offer.offer).collect();
        document.left_out = left_out;
        Ok(())
    }
}

fn outlook(farm: &Farm, job: usize, around: &planner::Input) -> Result<Vec<OutlookLine>, AdvanceError> {
    let asked = &farm.jobs[job];
    let line = |found: &planner::Outlook| {
        let finish = asked.finish(found.verdict.finish());
        OutlookLine {
            confidence: own_confidence(found.confidence),
            finish: finish.map(Timestamp::from_micros),
            in_time: asked.job.deadline.map(|_| asked.is_kept(finish)),
            cost: Money(found.cost),
            cost_at_least: Money(found.cost_bound),
        }
    };
    Ok(planner::outlook(around, job as u64)?.iter().map(line).collect())
}

fn own_offer(farm: &Farm, job: usize, offer: &planner::Offer) -> PriceOffer {
    let finish = farm.jobs[job].finish(Some(offer.finish)).unwrap_or(offer.finish);
    PriceOffer {
        deadline: Timestamp::from_micros(offer.deadline.max(finish)),
        finish: Timestamp::from_micros(finish),
        cost: Money(offer.cost),
        cost_at_least: Money(offer.cost_bound),
    }
}

fn why_not(
    farm: &Farm,
    around: &planner::Input,
    plan: &planner::Plan,
    job: usize,
    budget: Option<Money>,
) -> Vec<String> {
    let mut reasons = Vec::new();
    let asked = &farm.jobs[job];
    let finish = end(farm, plan, job);
    let entry = plan.job(job as u64);
    match (finish, asked.job.deadline.map(Timestamp::micros)) {
        (None, _) => reasons.push(if farm.nodes.is_empty() {
            "there is no node that takes work".to_owned()
        } else if matches!(
            entry.map(|entry| &entry.verdict),
            Some(planner::Verdict::Unplaced { shared_cache: true, .. })
        ) {
            NO_ROOM_FOR_CACHE.to_owned()
        } else {
            "some of its frames do not fit into any node's free time".to_owned()
        }),
        (Some(finish), Some(deadline)) if finish > deadline => {
            reasons.push(format!(
                "around the existing bookings it ends {} after the deadline",
                duration(finish - deadline)
            ));
            match entry.and_then(|entry| asked.finish(entry.bound.earliest_finish())) {
                Some(bound) if bound > deadline => reasons.push(format!(
                    "with all free time of {} it ends at {} at the earliest",
                    counted(farm.nodes.len(), "node"),
                    Timestamp::from_micros(bound)
                )),
                _ => {}
            }
            let short = plan.infeasible.iter().flat_map(|infeasible| &infeasible.short);
            for short in short.filter(|short| short.end - short.start >= SECOND) {
                reasons.push(format!(
                    "{} would have to be free from {} to {}",
                    counted(short.nodes.len(), "node"),
                    Timestamp::from_micros(short.start),
                    Timestamp::from_micros(short.end)
                ));
            }
            let mut holders: Vec<u64> = around
                .fixed
                .iter()
                .filter(|fixed| fixed.start < deadline)
                .filter_map(|fixed| fixed.job.filter(|&other| other != job as u64))
                .collect();
            holders.sort_unstable();
            holders.dedup();
            let names: Vec<&str> = holders
                .iter()
                .filter_map(|&other| farm.jobs.get(other as usize))
                .take(3)
                .map(|other| other.job.name.as_str())
                .collect();
            if !names.is_empty() {
                let (jobs, are) = (counted(holders.len(), "job"), is_or_are(holders.len()));
                reasons.push(format!("{jobs} {are} booked before then: {}", names.join(", ")));
            }
        }
        _ => {}
    }
    if let Some((entry, budget)) = entry.zip(budget)
        && entry.cost > budget.micro_units()
    {
        let above = entry.cost.saturating_sub(budget.micro_units());
        reasons
            .push(format!("the cheapest plan found costs {} more than the budget has left", amount(above)));
    }
    reasons
}

fn amount(micro_units: i64) -> String {
    Money(micro_units).to_string()
}

fn pushed_back(farm: &Farm, job: usize) -> Result<Vec<MovedJob>, AdvanceError> {
    let own = job as u64;
    let whole = farm.asked_whole(job, &farm.standing);
    if whole.jobs.len() < 2 {
        return Ok(Vec::new());
    }
    // Without the job the others may close up, so their bookings are not fixed.
    let mut without = planner::Input { movable: Vec::new(), ..whole };
    without.jobs.retain(|other| other.id != own);
    let Some(itself) = farm.input.jobs.get(job) else { return Ok(Vec::new()) };
    let effect = planner::what_if(&without, &Change::NewJob { job: Box::new(itself.clone()) })?;
    let later = |other: &MovedJob| other.later_ms > 0 || other.breaks_promise;
    Ok(farm.moved(&effect, own).into_iter().filter(later).collect())
}

/// Effects of one more node, one more hour and the loss of a node.
fn effects(snapshot: &Snapshot, farm: &Farm, job: usize) -> Result<Vec<PlanEffect>, AdvanceError> {
    let own = job as u64;
    let whole = farm.asked_whole(job, &farm.standing);
    let class = farm.input.jobs.get(job).map_or(0, |job| job.class);
    let mut by_price: Vec<&planner::Node> = whole.nodes.iter().collect();
    by_price.sort_by_key(|node| (node.price_of_work(class), node.id));
    let kinds = planner::kinds(by_price, class, KINDS);
    let mut changes: Vec<Change> =
        kinds.iter().map(|node| Change::MoreNodes { like: node.id, count: 1 }).collect();
    if farm.jobs[job].job.deadline.is_some() {
        changes.push(Change::Later { job: own, by: HOUR });
    }
    changes.extend(busiest(farm, own).map(|node| Change::NodeGone { node, from: farm.input.now }));
    let before = planner::plan(&whole)?;
    // More nodes do not help jobs whose bookings stay fixed. So both plans of this comparison fix nothing.
    let anew = |input: planner::Input| planner::plan(&planner::Input { movable: Vec::new(), ..input });
    let before_anew = if whole.movable.is_empty() { before.clone() } else { anew(whole.clone())? };
    let mut found = Vec::new();
    for change in &changes {
        let (then, before, after) = match change {
            Change::NodeGone { node, .. } => {
                let Some(gone) = farm.nodes.get(*node as usize) else { continue };
                let mut without = snapshot.clone();
                take_away(&mut without, gone.id);
                let without = Farm::new(&without);
                let after = planner::plan(&farm.asked_after(&without, job))?;
                (Some(without), &before, after)
            }
            Change::MoreNodes { .. } => (None, &before_anew, anew(planner::changed(&whole, change)?)?),
            _ => (None, &before, planner::plan(&planner::changed(&whole, change)?)?),
        };
        // Jobs keep their places.
        let then = then.as_ref().unwrap_or(farm);
        let finish = end(then, &after, job);
        let in_time = then.is_kept_after(change, job, finish);
        let effect = planner::effect(change, before, &after);
        found.extend(farm.told(change, effect.added_cost, finish, in_time, &farm.moved(&effect, own), job));
    }
    Ok(found)
}

/// The node with most of a job's booked time. Ties go to the smaller id.
fn busiest(farm: &Farm, job: u64) -> Option<u64> {
    let time = |node: u64| {
        let own = farm.standing.iter().filter(|booking| booking.job == job && booking.node == node);
        own.fold(0i64, |sum, booking| sum.saturating_add(booking.end - booking.start))
    };
    let nodes = farm.input.nodes.iter().map(|node| node.id);
    nodes.max_by_key(|&node| (time(node), std::cmp::Reverse(node))).filter(|&node| time(node) > 0)
}

pub(crate) fn curve_svg(document: &AnswersDoc) -> Result<String, PlotError> {
    let offer = |offer: &PriceOffer| plots::Offer {
        deadline: offer.deadline.micros(),
        cost: offer.cost.micro_units(),
        cost_bound: offer.cost_at_least.micro_units(),
    };
    let offers: Vec<plots::Offer> = document.curve.iter().map(offer).collect();
    plots::price_curve(&offers, |micro_units| Money(micro_units).to_string())
}

#[cfg(test)]
mod tests;
