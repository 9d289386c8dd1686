//! What jobs wait for in a plan, in words. Pure.

use std::collections::BTreeMap;

use forelight_planner as planner;
use forelight_planner::{Booking, Precedence, Reason};
use forelight_protocol::{ProjectShare, Timestamp, WaitKind, Waits};
use forelight_store::HALF_LIFE;

use super::AdvanceError;
use super::farm::{Asked, Farm};

/// What jobs wait for. Also: the plan's bookings, by job.
pub(super) fn waits(
    farm: &Farm,
    plan: &planner::Plan,
    bookings: &[Vec<&Booking>],
) -> Result<BTreeMap<usize, Waits>, AdvanceError> {
    let mut found = BTreeMap::new();
    let may_wait = |asked: &Asked| asked.begun.is_empty() && !asked.held;
    let explained: BTreeMap<u64, Reason> =
        planner::explain(&farm.input, plan, |job| may_wait(&farm.jobs[job as usize]))?
            .into_iter()
            .map(|explanation| (explanation.job, explanation.reason))
            .collect();
    for (job, asked) in farm.jobs.iter().enumerate() {
        if !asked.begun.is_empty() && !asked.held {
            continue;
        }
        let first = bookings[job].iter().map(|booking| booking.start).min();
        let until = first.map(Timestamp::from_micros);
        let share = share(farm, job);
        let waits =
            |kind, because: String, behind| Waits { kind, because, until, behind, share: share.clone() };
        if asked.held {
            found.insert(
                job,
                Waits { share: share.clone(), ..Waits::of_held(asked.job.paused, &asked.job.project) },
            );
        } else if let Some(reason) = explained.get(&(job as u64)) {
            let (kind, behind) = match reason {
                Reason::NoNode => (WaitKind::Node, Vec::new()),
                Reason::Calendar { .. } | Reason::NoRoom { .. } => (WaitKind::Calendar, Vec::new()),
                Reason::Behind { jobs } => (WaitKind::Others, jobs.clone()),
                Reason::Sooner | Reason::Booked => (WaitKind::Others, Vec::new()),
                Reason::Cheaper => (WaitKind::Cheaper, Vec::new()),
            };
            let because = match reason {
                Reason::Behind { jobs } => behind_in_words(farm, job, jobs),
                Reason::NoNode if farm.nodes.is_empty() => "waits because no node takes work".to_owned(),
                reason => reason.to_string(),
            };
            let behind =
                behind.iter().filter_map(|(job, _)| Some(farm.jobs.get(*job as usize)?.job.id)).collect();
            found.insert(job, waits(kind, because, behind));
        }
    }
    Ok(found)
}

fn behind_in_words(farm: &Farm, waiting: usize, jobs: &[(u64, Precedence)]) -> String {
    let mine = share(farm, waiting);
    let one = |(job, why): &(u64, Precedence)| -> Option<String> {
        let other = farm.jobs.get(*job as usize)?;
        let why = match why {
            _ if other.held && other.job.paused => "is booked there, although it is paused".to_owned(),
            _ if other.held => {
                format!("is booked there, although the budget of {} holds it", other.job.project)
            }
            Precedence::Fixed => "is being rendered".to_owned(),
            Precedence::Share { .. } => match (&mine, share(farm, *job as usize)) {
                (Some(mine), Some(theirs)) => format!(
                    "belongs to project {}, which had {:.1} node hours for a share of {}, while {} had {:.1} for a share of {}",
                    theirs.project,
                    theirs.used_hours,
                    theirs.share,
                    mine.project,
                    mine.used_hours,
                    mine.share
                ),
                _ => why.to_string(),
            },
            why => why.to_string(),
        };
        Some(format!("{}, which {why}", other.job.name))
    };
    let others: Vec<String> = jobs.iter().filter_map(one).collect();
    format!("waits because its nodes are booked for {}", others.join("; for "))
}

fn share(farm: &Farm, job: usize) -> Option<ProjectShare> {
    let project = farm.input.jobs.get(job)?.project?;
    farm.input.projects.iter().find(|entry| entry.id == project).map(|entry| share_of(entry, farm.input.now))
}

pub(crate) fn share_of(project: &planner::Project, now: i64) -> ProjectShare {
    let used = planner::decayed_usage(project, now, HALF_LIFE);
    ProjectShare {
        project: project.name.clone(),
        share: project.share.max(1),
        used_hours: used as f64 / 3.6e9,
    }
}
