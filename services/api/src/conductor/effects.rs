//! Effects of changes: turns the planner's numbers into names and words.

use forelight_planner as planner;
use forelight_planner::{Change, Effect};
use forelight_protocol::words::counted;
use forelight_protocol::{Money, MovedJob, PlanChange, PlanEffect, Timestamp};

use super::AdvanceError;
use super::farm::Farm;
use super::quantities::{confidence as planner_confidence, own_confidence};

/// Most waiting frames of a farm that is small enough to be planned whole for a question.
const SMALL: usize = 600;
const FEW: usize = 40;

impl From<planner::InputError> for AdvanceError {
    fn from(error: planner::InputError) -> Self {
        AdvanceError::Hopeless(format!("no plan could be made: {error}"))
    }
}

impl Farm {
    /// Whether questions about one job may move others.
    fn is_small(&self, standing: &[planner::Booking]) -> bool {
        standing.len() <= SMALL && self.jobs.len() <= FEW
    }

    /// Planner input for a question that may move others. On a large farm only the job is planned.
    pub fn asked_whole(&self, job: usize, standing: &[planner::Booking]) -> planner::Input {
        if self.is_small(standing) { self.with_standing(standing) } else { self.around(job, standing) }
    }

    /// The same after a change of this farm to `changed`.
    pub fn asked_after(&self, changed: &Farm, job: usize) -> planner::Input {
        if self.is_small(&self.standing) {
            changed.with_standing(&changed.standing)
        } else {
            changed.around(job, &changed.standing)
        }
    }

    /// The three cheapest ways to keep the job's deadline or budget that `standing` misses.
    pub fn ways_out(
        &self,
        job: usize,
        standing: &[planner::Booking],
        within_budget: bool,
    ) -> Result<Vec<PlanEffect>, AdvanceError> {
        let asked = self.asked_whole(job, standing);
        let mut found: Vec<PlanEffect> = planner::ways_out(&asked, job as u64)?
            .iter()
            .filter_map(|effect| self.effect(effect, job))
            .filter(|way| way.in_time)
            .collect();
        if !within_budget {
            found.extend(self.cheaper(job, standing)?);
        }
        found.sort_by_key(|effect| effect.added_cost);
        found.truncate(3);
        Ok(found)
    }

    fn cheaper(&self, job: usize, standing: &[planner::Booking]) -> Result<Vec<PlanEffect>, AdvanceError> {
        let around = self.around(job, standing);
        let own = job as u64;
        let Some(asked) = around.jobs.first() else { return Ok(Vec::new()) };
        let Some(budget) = asked.budget else { return Ok(Vec::new()) };
        let before = planner::plan(&around)?.cost;
        let mut found = Vec::new();
        if let Some(deadline) = asked.deadline
            && let Some(offer) = planner::earliest_for_budget(&around, own, budget)?
            && offer.deadline > deadline
        {
            let change = Change::Later { job: own, by: offer.deadline.saturating_sub(deadline) };
            found.extend(self.told(
                &change,
                offer.cost.saturating_sub(before),
                self.jobs[job].finish(Some(offer.finish)),
                true,
                &[],
                job,
            ));
        }
        for confidence in [planner::Confidence::P80, planner::Confidence::P50] {
            if confidence >= asked.confidence {
                continue;
            }
            let change = Change::Confidence { job: own, confidence };
            let after = planner::plan(&planner::changed(&around, &change)?)?;
            if let Some(entry) = after.job(own)
                && entry.within_budget == Some(true)
                && entry.verdict.is_kept()
            {
                let finish = self.jobs[job].finish(entry.verdict.finish());
                found.extend(self.told(&change, after.cost.saturating_sub(before), finish, true, &[], job));
                break;
            }
        }
        Ok(found)
    }

    pub fn effect(&self, effect: &Effect, job: usize) -> Option<PlanEffect> {
        let own = job as u64;
        // The planner does not see the frames under way.
        let finish = self.jobs[job].finish(effect.end(own));
        let in_time = !effect.broken.contains(&own) && self.is_kept_after(&effect.change, job, finish);
        self.told(&effect.change, effect.added_cost, finish, in_time, &self.moved(effect, own), job)
    }

    /// Whether a job that ends then after a change keeps its deadline, which the change may have moved.
    pub fn is_kept_after(&self, change: &Change, job: usize, finish: Option<i64>) -> bool {
        let later = match change {
            Change::Later { job: id, by } if *id == job as u64 => *by,
            _ => 0,
        };
        self.jobs[job].is_kept(finish.map(|finish| finish.saturating_sub(later)))
    }

    pub fn moved(&self, effect: &Effect, own: u64) -> Vec<MovedJob> {
        let moved = effect.moved().into_iter().filter(|&(other, _)| other != own);
        moved
            .filter_map(|(other, by)| {
                let asked = self.jobs.get(usize::try_from(other).ok()?)?;
                Some(MovedJob {
                    job_id: asked.job.id,
                    name: asked.job.name.clone(),
                    later_ms: by / 1000,
                    breaks_promise: effect.broken.contains(&other),
                })
            })
            .collect()
    }

    pub fn told(
        &self,
        change: &Change,
        added_cost: i64,
        finish: Option<i64>,
        in_time: bool,
        moved: &[MovedJob],
        job: usize,
    ) -> Option<PlanEffect> {
        let (change, mut words) = self.named(change, job)?;
        words += &format!(": {}", priced(added_cost));
        for other in moved.iter().filter(|other| other.breaks_promise) {
            let of = self.jobs.iter().find(|asked| asked.job.id == other.job_id);
            let has_deadline = of.is_some_and(|asked| asked.job.deadline.is_some());
            let what = if has_deadline { "misses its deadline" } else { "is not rendered" };
            words += &format!("; {} {what}", other.name);
        }
        let later = moved.iter().filter(|other| other.later_ms > 0 && !other.breaks_promise).count();
        if later > 0 {
            let end = if later == 1 { "ends" } else { "end" };
            words += &format!("; {} {end} later", counted(later, "other job"));
        }
        Some(PlanEffect {
            change,
            words,
            added_cost: Money(added_cost),
            finish: finish.map(Timestamp::from_micros),
            in_time,
            moved: moved.to_vec(),
        })
    }

    fn named(&self, change: &Change, job: usize) -> Option<(PlanChange, String)> {
        let node = |id: u64| self.nodes.get(usize::try_from(id).ok()?);
        let other = |id: u64| Some(&self.jobs.get(usize::try_from(id).ok()?)?.job);
        let whose = |id: u64| -> Option<String> {
            Some(if id == job as u64 { String::new() } else { format!(" of {}", other(id)?.name) })
        };
        Some(match change {
            Change::MoreNodes { like, count } => {
                let like = node(*like)?;
                let words = match count {
                    1 => format!("one more node like {}", like.name),
                    count => format!("{count} more nodes like {}", like.name),
                };
                (PlanChange::MoreNodes { node_id: like.id, count: *count }, words)
            }
            Change::NodeGone { node: gone, .. } => {
                let gone = node(*gone)?;
                (PlanChange::NodeGone { node_id: gone.id }, format!("without node {}", gone.name))
            }
            Change::Later { job: id, by } => {
                let way = if *by < 0 { "earlier" } else { "later" };
                let by_how_much = duration(by.saturating_abs());
                let words = format!("the deadline{} {by_how_much} {way}", whose(*id)?);
                (PlanChange::Later { job_id: other(*id)?.id, by_ms: by / 1000 }, words)
            }
            Change::Confidence { job: id, confidence } => {
                let per_cent = confidence.probability() * 100.0;
                let job = other(*id)?;
                let only = if *confidence < planner_confidence(job.confidence) { " only" } else { "" };
                let words = format!("at a confidence{} of {per_cent:.0} %{only}", whose(*id)?);
                let confidence = own_confidence(*confidence);
                (PlanChange::Confidence { job_id: job.id, confidence }, words)
            }
            Change::MakeWay { job: id } => {
                let other = other(*id)?;
                (PlanChange::MakeWay { job_id: other.id }, format!("{} gives up its deadline", other.name))
            }
            // A job's division is fixed when it is submitted.
            Change::Parts { .. } => return None,
            Change::NewJob { job } => {
                let other = other(job.id)?;
                (PlanChange::WithoutJob { job_id: other.id }, format!("without {}", other.name))
            }
        })
    }
}

/// `+1.20` or `-0.35` in units of the currency, or `at no extra cost`.
pub(crate) fn priced(micro_units: i64) -> String {
    match micro_units {
        0 => "at no extra cost".to_owned(),
        1.. => format!("+{}", Money(micro_units)),
        _ => Money(micro_units).to_string(),
    }
}

/// `the only node`, `all 2 nodes`.
pub(crate) fn all_nodes(count: usize) -> String {
    if count == 1 { "the only node".to_owned() } else { format!("all {count} nodes") }
}

/// A duration for people, from microseconds.
pub(crate) fn duration(micros: i64) -> String {
    forelight_protocol::duration_in_words(micros / 1_000_000)
}
