//! Changes of a plan, with names and in words.

use std::collections::{BTreeMap, BTreeSet};

use forelight_planner as planner;
use forelight_protocol::{
    Booking, FrameMove, FramePlace, JobId, JobVerdict, Money, NodeId, Plan, PlanDifference, Timestamp,
    Verdict, VerdictChange,
};
use forelight_store::{Store, StoreError};

use crate::conductor::effects::priced;
use crate::conductor::numbers::{frame_part, number};
use crate::conductor::settle::stayed;

const MOST_LINES: usize = 50;

/// Most moves of frames that a difference lists.
const MOST_MOVES: usize = 1_000;

/// Compares a plan, or the part of it that somebody sees, with the bookings before it.
pub(crate) async fn difference(store: &Store, after: Plan) -> Result<PlanDifference, StoreError> {
    let plan = after.id;
    let (mut before, said) = store.booked_before(plan).await?;
    before.retain(|booking| after.verdicts.iter().any(|verdict| verdict.job_id == booking.job_id));
    let places = Places::new(before.iter().chain(&after.bookings));
    let compared = planner::difference(&places.plan(&before), &places.plan(&after.bookings));
    let mut nodes = BTreeMap::new();
    for id in &places.nodes {
        nodes.insert(*id, store.node_name(*id).await?);
    }
    let mut frames: Vec<FrameMove> = Vec::new();
    let moved = compared.moved.iter().filter(|(old, new)| !stayed(old, new));
    let pairs = moved.map(|(old, new)| (Some(old), Some(new)));
    let pairs = pairs.chain(compared.added.iter().map(|new| (None, Some(new))));
    let pairs = pairs.chain(compared.removed.iter().map(|old| (Some(old), None)));
    for (old, new) in pairs {
        frames.extend(places.frame(old, new, &nodes));
    }
    frames.sort_by_key(|frame| (frame.job_id, frame.frame));
    let elsewhere = frames.iter().filter(|frame| frame.after.is_some()).count();
    let unmoved = after.bookings.len().saturating_sub(elsewhere);
    let mut jobs = Vec::new();
    let mut added_cost = 0i64;
    for verdict in &after.verdicts {
        let old = said.iter().find(|old| old.job_id == verdict.job_id);
        let cost =
            |verdict: Option<&JobVerdict>| verdict.and_then(|verdict| verdict.cost).unwrap_or_default().0;
        added_cost = added_cost.saturating_add(cost(Some(verdict)).saturating_sub(cost(old)));
        if old != Some(verdict) {
            let name = match store.job(verdict.job_id).await {
                Ok(job) => job.name,
                Err(StoreError::NotFound(_)) => continue,
                Err(error) => return Err(error),
            };
            jobs.push(VerdictChange {
                job_id: verdict.job_id,
                name,
                before: old.cloned(),
                after: verdict.clone(),
            });
        }
    }
    let mut difference = PlanDifference {
        plan_id: plan,
        parent_id: after.parent_id,
        causes: after.causes,
        words: Vec::new(),
        jobs,
        frames,
        frames_left_out: 0,
        unmoved: unmoved as u64,
        added_cost: Money(added_cost),
    };
    difference.words = words(&difference);
    Ok(shortened(difference))
}

/// With as many moves as a page can show. The words are about all.
fn shortened(mut difference: PlanDifference) -> PlanDifference {
    difference.frames_left_out = difference.frames.len().saturating_sub(MOST_MOVES) as u64;
    difference.frames.truncate(MOST_MOVES);
    difference
}

struct Places {
    jobs: Vec<JobId>,
    nodes: Vec<NodeId>,
}

impl Places {
    fn new<'a>(bookings: impl Iterator<Item = &'a Booking>) -> Self {
        let (mut jobs, mut nodes) = (BTreeSet::new(), BTreeSet::new());
        for booking in bookings {
            jobs.insert(booking.job_id);
            nodes.insert(booking.node_id);
        }
        Self { jobs: jobs.into_iter().collect(), nodes: nodes.into_iter().collect() }
    }

    fn plan(&self, bookings: &[Booking]) -> planner::Plan {
        let own = |booking: &Booking| {
            Some(planner::Booking {
                start: booking.start.micros(),
                node: self.nodes.binary_search(&booking.node_id).ok()? as u64,
                job: self.jobs.binary_search(&booking.job_id).ok()? as u64,
                task: planner::Task::Frame(number(booking.frame_part())),
                end: booking.end.micros(),
            })
        };
        planner::Plan { bookings: bookings.iter().filter_map(own).collect(), ..planner::Plan::default() }
    }

    fn frame(
        &self,
        old: Option<&planner::Booking>,
        new: Option<&planner::Booking>,
        names: &BTreeMap<NodeId, String>,
    ) -> Option<FrameMove> {
        let place = |booking: &planner::Booking| {
            let node_id = *self.nodes.get(usize::try_from(booking.node).ok()?)?;
            Some(FramePlace {
                node_id,
                node: names.get(&node_id).cloned().unwrap_or_default(),
                start: Timestamp::from_micros(booking.start),
                end: Timestamp::from_micros(booking.end),
            })
        };
        let one = new.or(old)?;
        let part = frame_part(one.task)?;
        Some(FrameMove {
            job_id: *self.jobs.get(usize::try_from(one.job).ok()?)?,
            frame: part.frame,
            part: part.part,
            parts: part.parts,
            before: old.and_then(place),
            after: new.and_then(place),
        })
    }
}

fn words(difference: &PlanDifference) -> Vec<String> {
    let count = |which: fn(&FrameMove) -> bool| difference.frames.iter().filter(|frame| which(frame)).count();
    let mut words = Vec::new();
    if !difference.causes.is_empty() {
        words.push(format!("because {}", difference.causes.join("; ")));
    }
    let moved = count(|frame| frame.before.is_some() && frame.after.is_some());
    let kinds = [
        (count(|frame| frame.before.is_none()), "booked for the first time"),
        (count(|frame| frame.after.is_none()), "without a booking"),
    ];
    let kinds = kinds.iter().filter(|(number, _)| *number > 0);
    let others: String = kinds.map(|(number, kind)| format!(", {number} {kind}")).collect();
    let cost = priced(difference.added_cost.micro_units());
    words.push(format!("{moved} frames moved{others}, {} unchanged; {cost}", difference.unmoved));
    words.extend(difference.jobs.iter().filter_map(of_job));
    let name = |job: JobId| {
        difference
            .jobs
            .iter()
            .find(|change| change.job_id == job)
            .map_or_else(|| job.to_string(), |change| change.name.clone())
    };
    for frame in difference.frames.iter().take(MOST_LINES) {
        let at = |place: &FramePlace| format!("{} from {}", place.node, place.start);
        words.push(match (&frame.before, &frame.after) {
            (Some(old), Some(new)) => {
                format!("{}, frame {}: {} instead of {}", name(frame.job_id), frame.frame, at(new), at(old))
            }
            (None, Some(new)) => format!("{}, frame {}: {}", name(frame.job_id), frame.frame, at(new)),
            (old, None) => format!(
                "{}, frame {}: no longer booked{}",
                name(frame.job_id),
                frame.frame,
                old.as_ref().map(|old| format!(", was on {}", at(old))).unwrap_or_default()
            ),
        });
    }
    if difference.frames.len() > MOST_LINES {
        words.push(format!("and {} frames more", difference.frames.len() - MOST_LINES));
    }
    words
}

/// What a plan changes for a job, as one line. `None` if nothing that counts.
pub(crate) fn of_job(change: &VerdictChange) -> Option<String> {
    let end = |verdict: &JobVerdict| verdict.finish.map_or("never".to_owned(), |finish| finish.to_string());
    let Some(before) = &change.before else {
        return Some(format!("{} ends {}", change.name, end(&change.after)));
    };
    let moved = before.finish != change.after.finish;
    let word = match (before.verdict, change.after.verdict) {
        (old, new) if old == new => "",
        (_, Verdict::OnTime) => " and is in time now",
        (_, Verdict::Late) => " and misses its deadline now",
        (_, Verdict::OverBudget) => " and is above its budget now",
        (_, Verdict::Impossible) => " and has no booking any more",
    };
    (moved || !word.is_empty())
        .then(|| format!("{} ends {} instead of {}{word}", change.name, end(&change.after), end(before)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::PlanId;

    #[test]
    fn a_difference_lists_a_thousand_frames_and_counts_all() {
        let job_id = JobId::new();
        let frames =
            (0..1101).map(|frame| FrameMove { job_id, frame, part: 0, parts: 1, before: None, after: None });
        let mut difference = PlanDifference {
            plan_id: PlanId::new(),
            parent_id: None,
            causes: Vec::new(),
            words: Vec::new(),
            jobs: Vec::new(),
            frames: frames.collect(),
            frames_left_out: 0,
            unmoved: 7,
            added_cost: Money(0),
        };
        difference.words = words(&difference);
        let shortened = shortened(difference);
        assert_eq!((shortened.frames.len(), shortened.frames_left_out), (1000, 101));
        assert!(shortened.words[0].contains("1101 booked for the first time"), "{:?}", shortened.words);
    }
}
