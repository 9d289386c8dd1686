//! What a change would do to the plan: the farm is planned as it stands and as it would stand, in the way in
//! which the conductor would do it. Pure.

use std::collections::{BTreeMap, BTreeSet};

use forelight_planner as planner;
use forelight_planner::Change;
use forelight_protocol::{
    AccuracyRung, FramePart, JobId, MovedJob, NodeId, PlanChange, Promise, Timestamp, VerdictChange, WhatIf,
};
use forelight_store::FarmJob;

use super::AdvanceError;
use super::farm::{Farm, Snapshot};
use super::qualities::qualities;
use super::quantities::confidence;
use super::settle::{STILL, Settled, Unsettled, end, settle};
use crate::plan_difference::of_job;

/// Most lines of a difference.
const MOST_LINES: usize = 50;
/// Most nodes that a question may add.
const MOST_NODES_ADDED: u32 = 1000;

/// What a change would do. The inner error says what is wrong with the change.
pub(crate) fn what_if(
    snapshot: &Snapshot,
    job: JobId,
    change: &PlanChange,
    rungs: &[AccuracyRung],
) -> Result<Result<WhatIf, String>, AdvanceError> {
    let farm = Farm::new(snapshot);
    let Some(place) = farm.place(job) else {
        return Err(AdvanceError::Hopeless("the job has no forecast to plan with".to_owned()));
    };
    if let PlanChange::Quality { .. } = change {
        return at_quality(&farm, place, change, rungs);
    }
    let mut changed = snapshot.clone();
    let asked = match apply(&mut changed, change).and_then(|()| named(&farm, change)) {
        Ok(asked) => asked,
        Err(reason) => return Ok(Err(reason)),
    };
    let is_on_hold = farm.jobs[place].job.plan_id.is_none();
    let before = planned(&farm, is_on_hold.then_some(place))?;
    let after_farm = Farm::new(&changed);
    let after_place = after_farm.place(job);
    let after = planned(&after_farm, after_place.filter(|_| is_on_hold))?;
    let moved = moved((&farm, &before), (&after_farm, &after), job);
    let added = after.plan.cost.saturating_sub(before.plan.cost);
    let finish = after_place.and_then(|place| end(&after_farm, &after.plan, place));
    let in_time = after_place.is_some_and(|place| after_farm.jobs[place].is_kept(finish));
    let effect = farm.told(&asked, added, finish, in_time, &moved, place);
    let effect = effect.ok_or_else(|| AdvanceError::Hopeless("the change has no words".to_owned()))?;
    Ok(Ok(WhatIf { effect, words: words(&farm, &before, &after_farm, &after) }))
}

fn at_quality(
    farm: &Farm,
    place: usize,
    change: &PlanChange,
    rungs: &[AccuracyRung],
) -> Result<Result<WhatIf, String>, AdvanceError> {
    let PlanChange::Quality { spp, width, height, settings } = change else {
        return Ok(Err("this is no quality".to_owned()));
    };
    let is_asked = |rung: &&AccuracyRung| match settings {
        Some(settings) => **settings == rung.settings,
        None => (rung.settings.spp, rung.settings.width, rung.settings.height) == (*spp, *width, *height),
    };
    let (Some(own), Some(rung)) = (rungs.iter().find(|rung| rung.asked_for), rungs.iter().find(is_asked))
    else {
        return Ok(Err(
            "the job's quote has no such quality; /v1/jobs/{id}/accuracy lists those that it has".to_owned(),
        ));
    };
    let before = planner::plan(&farm.around(place, &farm.standing))?.cost;
    let both = [own.clone(), rung.clone()];
    for offer in qualities(farm, place, &farm.standing, &both) {
        let offer = offer?;
        if offer.offer.settings == rung.settings {
            return Ok(Ok(WhatIf { effect: offer.effect(before), words: Vec::new() }));
        }
    }
    Ok(Err("the job's quote does not say what this quality costs".to_owned()))
}

fn planned(farm: &Farm, fresh: Option<usize>) -> Result<Settled, AdvanceError> {
    settle(farm, fresh).map_err(|unsettled| match unsettled {
        Unsettled::Failed(error) => error,
        Unsettled::Refused(violations) => {
            let first = violations.first().map(ToString::to_string).unwrap_or_default();
            AdvanceError::Hopeless(format!("the verifier refused the plan: {first}"))
        }
    })
}

/// Changes the farm.
fn apply(farm: &mut Snapshot, change: &PlanChange) -> Result<(), String> {
    fn job(farm: &mut Snapshot, id: JobId) -> Result<&mut FarmJob, String> {
        let found = farm.jobs.iter_mut().find(|job| job.job.id == id);
        let found = found.ok_or_else(|| format!("there is no booked job {id}"))?;
        found.has_new_terms = found.job.plan_id.is_some();
        Ok(found)
    }
    match change {
        PlanChange::Later { job_id, by_ms } => {
            let job = &mut job(farm, *job_id)?.job;
            let deadline = job.deadline.ok_or_else(|| format!("job {} has no deadline", job.name))?;
            job.deadline = Some(deadline.plus_micros(by_ms.saturating_mul(1000)));
        }
        PlanChange::Confidence { job_id, confidence } => job(farm, *job_id)?.job.confidence = *confidence,
        PlanChange::MakeWay { job_id } => job(farm, *job_id)?.job.deadline = None,
        PlanChange::WithoutJob { job_id } => {
            job(farm, *job_id)?;
            farm.jobs.retain(|job| job.job.id != *job_id);
            farm.projected.frames.retain(|frame| frame.booking.job_id != *job_id);
            farm.projected.cache_parts.retain(|part| part.booking.job_id != *job_id);
        }
        PlanChange::NodeGone { node_id } => {
            node_place(&farm.nodes, *node_id)?;
            take_away(farm, *node_id);
        }
        PlanChange::MoreNodes { node_id, count } => {
            let like = farm.nodes[node_place(&farm.nodes, *node_id)?].clone();
            if !(1..=MOST_NODES_ADDED).contains(count) {
                return Err(format!("{count} nodes; a question may add 1 to {MOST_NODES_ADDED}"));
            }
            for number in 1..=*count {
                let name = format!("{} +{number}", like.name);
                farm.nodes.push(forelight_protocol::Node { id: NodeId::new(), name, ..like.clone() });
            }
        }
        PlanChange::Quality { .. } => return Err("a quality is no change of the farm".to_owned()),
    }
    Ok(())
}

/// Takes a node away. Frames under way on it wait again. Parts of caches begin again on other nodes.
pub(crate) fn take_away(farm: &mut Snapshot, node: NodeId) {
    let lost = farm.projected.frames.iter().filter(|frame| frame.under_way && frame.node_id == node);
    let lost: BTreeSet<(JobId, FramePart)> =
        lost.map(|frame| (frame.booking.job_id, frame.booking.frame_part())).collect();
    for job in &mut farm.jobs {
        for frame in &mut job.frames {
            frame.waits |= lost.contains(&(job.job.id, frame.frame));
        }
    }
    farm.projected.frames.retain(|frame| frame.node_id != node);
    farm.nodes.retain(|other| other.id != node);
    move_cache_parts(farm, node);
}

/// Books the parts of caches of a lost node elsewhere: each where its job works already, or else on any node,
/// behind what workers have there.
fn move_cache_parts(farm: &mut Snapshot, lost: NodeId) {
    let now = farm.now;
    let mut free_from: BTreeMap<NodeId, Timestamp> = farm.nodes.iter().map(|node| (node.id, now)).collect();
    let mut nodes_of: BTreeSet<(JobId, NodeId)> = BTreeSet::new();
    let frames = farm.projected.frames.iter();
    let frames = frames.map(|frame| (frame.booking.job_id, frame.node_id, frame.end, frame.under_way));
    // Parts stay in front of the frames that wait.
    let parts = farm.projected.cache_parts.iter();
    let parts = parts.map(|part| (part.booking.job_id, part.node_id, part.end, true));
    for (job, node, end, is_ahead) in frames.chain(parts) {
        if let Some(free) = free_from.get_mut(&node) {
            nodes_of.insert((job, node));
            *free = if is_ahead { (*free).max(end) } else { *free };
        }
    }
    for part in farm.projected.cache_parts.iter_mut().filter(|part| part.node_id == lost) {
        let is_known = |node: NodeId| nodes_of.contains(&(part.booking.job_id, node));
        let place = free_from.iter_mut().min_by_key(|(node, free)| (!is_known(**node), **free));
        let Some((&node, free)) = place else { return };
        // A part under way counts as a whole one, though at most its round is lost: how much of it is filled is not
        // known here.
        let start = if part.under_way { *free } else { part.start.max(*free) };
        part.attempt = None;
        (part.node_id, part.start, part.end) = (node, start, start.plus_micros(part.length));
        (part.under_way, *free) = (false, part.end);
    }
    farm.projected.cache_parts.sort_by_key(|part| (part.start, part.node_id, part.booking.job_id));
}

fn node_place(nodes: &[forelight_protocol::Node], node: NodeId) -> Result<usize, String> {
    let place = nodes.iter().position(|other| other.id == node);
    place.ok_or_else(|| format!("there is no node {node} that takes work"))
}

/// The change in the planner's numbers.
fn named(farm: &Farm, change: &PlanChange) -> Result<Change, String> {
    let place = |job: JobId| {
        farm.place(job).map(|place| place as u64).ok_or_else(|| format!("there is no booked job {job}"))
    };
    let node = |node| node_place(&farm.nodes, node).map(|place| place as u64);
    Ok(match change {
        PlanChange::MoreNodes { node_id, count } => {
            Change::MoreNodes { like: node(*node_id)?, count: *count }
        }
        PlanChange::NodeGone { node_id } => Change::NodeGone { node: node(*node_id)?, from: farm.input.now },
        PlanChange::Later { job_id, by_ms } => {
            Change::Later { job: place(*job_id)?, by: by_ms.saturating_mul(1000) }
        }
        PlanChange::Confidence { job_id, confidence: wanted } => {
            Change::Confidence { job: place(*job_id)?, confidence: confidence(*wanted) }
        }
        PlanChange::MakeWay { job_id } => Change::MakeWay { job: place(*job_id)? },
        PlanChange::WithoutJob { job_id } => {
            let place = place(*job_id)? as usize;
            Change::NewJob { job: Box::new(farm.input.jobs[place].clone()) }
        }
        PlanChange::Quality { .. } => return Err("a quality is no change of the farm".to_owned()),
    })
}

/// The other jobs that end at another time, or miss a deadline that they would keep.
fn moved(before: (&Farm, &Settled), after: (&Farm, &Settled), own: JobId) -> Vec<MovedJob> {
    let mut moved = Vec::new();
    for (place, asked) in before.0.jobs.iter().enumerate().filter(|(_, asked)| asked.job.id != own) {
        let Some(other) = after.0.place(asked.job.id) else { continue };
        let old = end(before.0, &before.1.plan, place);
        let new = end(after.0, &after.1.plan, other);
        let breaks_promise = asked.is_kept(old) && !after.0.jobs[other].is_kept(new);
        let later = old.zip(new).map_or(0, |(old, new)| new.saturating_sub(old));
        if breaks_promise || later.abs() > STILL {
            let name = asked.job.name.clone();
            moved.push(MovedJob { job_id: asked.job.id, name, later_ms: later / 1000, breaks_promise });
        }
    }
    moved
}

/// The difference between two plans, one line for each statement.
fn words(farm: &Farm, before: &Settled, after_farm: &Farm, after: &Settled) -> Vec<String> {
    let said: BTreeMap<JobId, _> =
        before.jobs.iter().map(|planned| (planned.verdict.job_id, &planned.verdict)).collect();
    let name = |job: JobId| farm.place(job).map_or(String::new(), |place| farm.jobs[place].job.name.clone());
    let mut lines = Vec::new();
    for planned in &after.jobs {
        let id = planned.verdict.job_id;
        let kept = farm.place(id).and_then(|place| farm.jobs[place].job.verdict.as_ref());
        let change = VerdictChange {
            job_id: id,
            name: name(id),
            before: said.get(&id).copied().or(kept).cloned(),
            after: planned.verdict.clone(),
        };
        lines.extend(of_job(&change));
    }
    let promises = |settled: &Settled| -> BTreeMap<JobId, Promise> {
        let promised = settled.outlooks.iter();
        promised.filter_map(|(job, outlook)| Some((*job, outlook.promise.clone()?))).collect()
    };
    let (old, new) = (promises(before), promises(after));
    for asked in &after_farm.jobs {
        let (Some(old), Some(new)) = (old.get(&asked.job.id), new.get(&asked.job.id)) else { continue };
        if old.kept != new.kept {
            let sure = new.probability * 100.0;
            let word = if new.kept { "keeps its deadline then" } else { "is at risk then" };
            lines.push(format!("{} {word}, with a probability of {sure:.0} %", asked.job.name));
        }
    }
    let more = lines.len().saturating_sub(MOST_LINES);
    lines.truncate(MOST_LINES);
    if more > 0 {
        lines.push(format!("and {more} lines more"));
    }
    lines
}
