//! What a caller who reaches some projects only is shown of documents about the whole farm.
//!
//! The rule: no id, name or figure of another project's job. Node times that such jobs take are shown as
//! taken.

use std::collections::BTreeSet;

use forelight_protocol::{
    AnswersDoc, Dashboard, Event, EventKind, Job, JobId, JobVerdict, Node, Plan, PlanChange, PlanEffect,
    Promise, Role, TimelinePage, Waits,
};
use forelight_store::tokens::Principal;

use crate::conductor::settle::IN_THE_WAY;
use crate::error::ApiResult;
use crate::state::App;

/// Which of some jobs a caller sees.
pub(crate) enum Seen {
    All,
    Some(BTreeSet<JobId>),
}

impl App {
    /// Which of these jobs the caller sees.
    pub async fn seen(&self, caller: &Principal, jobs: impl IntoIterator<Item = JobId>) -> ApiResult<Seen> {
        if caller.reaches_all() {
            return Ok(Seen::All);
        }
        Ok(Seen::Some(self.store.seen_jobs(caller, jobs).await?))
    }
}

/// Leaves out of a reason to wait the jobs that are not seen. If there are any, it says only `because`.
fn name_only_seen(waits: &mut Waits, sees: impl Fn(JobId) -> bool, because: &str) {
    if waits.behind.iter().any(|&job| !sees(job)) {
        waits.behind.retain(|&job| sees(job));
        because.clone_into(&mut waits.because);
    }
}

impl Seen {
    pub fn sees(&self, job: JobId) -> bool {
        match self {
            Seen::All => true,
            Seen::Some(jobs) => jobs.contains(&job),
        }
    }

    fn sees_effect(&self, effect: &PlanEffect) -> bool {
        in_effect(effect).all(|job| self.sees(job))
    }

    /// Leaves out of a job what it says of others.
    pub fn show(&self, waits: &mut Option<Waits>, promise: &mut Option<Promise>) {
        if let Some(waits) = waits {
            name_only_seen(waits, |job| self.sees(job), "waits because jobs of other projects go first");
        }
        if let Some(promise) = promise
            && promise.rescue.as_ref().is_some_and(|rescue| !self.sees_effect(rescue))
        {
            promise.rescue = None;
        }
    }

    /// Leaves out of a job what it says of others.
    pub fn show_job(&self, job: &mut Job) {
        self.show(&mut job.waits, &mut job.promise);
        if let Some(verdict) = &mut job.verdict {
            self.show_verdict(verdict);
        }
    }

    fn show_verdict(&self, verdict: &mut JobVerdict) {
        if let Seen::Some(_) = self {
            verdict.ways_out.retain(|effect| self.sees_effect(effect));
            let reasons = verdict.reasons.iter_mut().filter(|reason| reason.starts_with(IN_THE_WAY));
            reasons.for_each(|reason| reason.truncate(IN_THE_WAY.len()));
        }
    }

    /// A plan without what it says of others. `None` if it says nothing else.
    pub fn show_plan(&self, mut plan: Plan) -> Option<Plan> {
        if let Seen::Some(_) = self {
            plan.causes.clear();
            plan.verdicts.retain(|verdict| self.sees(verdict.job_id));
            plan.verdicts.iter_mut().for_each(|verdict| self.show_verdict(verdict));
            plan.bookings.retain(|booking| self.sees(booking.job_id));
            plan.shared_cache_bookings.retain(|booking| self.sees(booking.job_id));
            if plan.verdicts.is_empty() && plan.bookings.is_empty() {
                return None;
            }
        }
        Some(plan)
    }

    /// Leaves out of the answers about a job what they say of others.
    pub fn show_answers(&self, mut answers: AnswersDoc) -> AnswersDoc {
        if let Seen::Some(_) = self {
            answers.what_if.retain(|effect| self.sees_effect(effect));
            answers.ways_out.retain(|effect| self.sees_effect(effect));
            answers.pushes_back.retain(|moved| self.sees(moved.job_id));
            answers.why_not.clear();
        }
        answers
    }

    /// Leaves other projects' jobs out of a timeline. Their nodes are taken by a job without a name.
    pub fn show_timeline(&self, page: &mut TimelinePage) {
        if let Seen::Some(_) = self {
            page.items.iter_mut().for_each(|node| node.idle_because = None);
        }
        page.jobs.retain(|job| self.sees(job.id));
        for span in page.items.iter_mut().flat_map(|node| &mut node.spans) {
            if span.job_id.is_some_and(|job| !self.sees(job)) {
                span.job_id = None;
                span.frames = None;
            }
        }
    }
}

/// The jobs that a job's documents mention.
pub(crate) fn mentioned<'a>(
    waits: &'a Option<Waits>,
    promise: &'a Option<Promise>,
) -> impl Iterator<Item = JobId> + 'a {
    let behind = waits.iter().flat_map(|waits| waits.behind.iter().copied());
    behind.chain(promise.iter().flat_map(|promise| promise.rescue.iter()).flat_map(in_effect))
}

/// The jobs that a job mentions.
pub(crate) fn mentioned_by(job: &Job) -> impl Iterator<Item = JobId> + '_ {
    let ways_out = job.verdict.iter().flat_map(|verdict| &verdict.ways_out);
    mentioned(&job.waits, &job.promise).chain(ways_out.flat_map(in_effect))
}

/// The jobs that a plan mentions.
pub(crate) fn mentioned_in(plan: &Plan) -> impl Iterator<Item = JobId> + '_ {
    let verdicts = plan.verdicts.iter();
    let said = verdicts.flat_map(|said| said.ways_out.iter().flat_map(in_effect).chain([said.job_id]));
    let caches = plan.shared_cache_bookings.iter().map(|booking| booking.job_id);
    said.chain(plan.bookings.iter().map(|booking| booking.job_id)).chain(caches)
}

/// The jobs that an effect mentions.
pub(crate) fn in_effect(effect: &PlanEffect) -> impl Iterator<Item = JobId> + '_ {
    let about = match &effect.change {
        PlanChange::Later { job_id, .. }
        | PlanChange::Confidence { job_id, .. }
        | PlanChange::MakeWay { job_id }
        | PlanChange::WithoutJob { job_id } => Some(*job_id),
        PlanChange::MoreNodes { .. } | PlanChange::NodeGone { .. } | PlanChange::Quality { .. } => None,
    };
    about.into_iter().chain(effect.moved.iter().map(|moved| moved.job_id))
}

impl App {
    /// Nodes as the caller sees them. Why one is idle or was set aside may name any job. Workers are told of
    /// no job.
    pub async fn shown_nodes(&self, caller: &Principal, mut nodes: Vec<Node>) -> ApiResult<Vec<Node>> {
        let jobs = nodes.iter().filter_map(|node| Some(node.activity.as_ref()?.job_id));
        let seen = self.seen(caller, jobs.collect::<Vec<_>>()).await?;
        for node in &mut nodes {
            let is_seen = |job| caller.role != Role::Worker && seen.sees(job);
            node.activity = node.activity.take().filter(|activity| is_seen(activity.job_id));
            if !caller.reaches_all() {
                node.idle_reason = None;
                let hidden = || "its reason is for those who see all projects".to_owned();
                node.set_aside = node.set_aside.as_ref().map(|_| hidden());
            }
        }
        Ok(nodes)
    }
}

/// An event without what it may say of other projects' jobs.
pub(crate) fn without_others(event: &Event) -> Event {
    // What is about no project may name anything.
    let is_of_many = event.project.is_none() || event.kind == EventKind::PlanStored;
    let promise = event.promise.clone().map(|promise| Promise { rescue: None, ..promise });
    let message = event.message.clone().filter(|_| !is_of_many);
    let task_id = event.task_id.filter(|_| event.project.is_some());
    let job = event.job.clone().map(|mut news| {
        if let Some(waits) = &mut news.waits {
            // Whose jobs these are is not known here.
            name_only_seen(waits, |_| false, "waits because other jobs go first");
        }
        news
    });
    Event { promise, message, task_id, job, ..event.clone() }
}

/// A dashboard for a caller who reaches some projects only. `jobs` are those of his that it mentions.
pub(crate) fn show_dashboard(mut farm: Dashboard, caller: &Principal, seen: &Seen) -> Dashboard {
    farm.finish = None;
    farm.jobs.retain(|job| caller.sees(&job.project));
    for job in &mut farm.jobs {
        seen.show(&mut job.waits, &mut job.promise);
    }
    farm.bookings.retain(|booking| seen.sees(booking.job_id));
    farm.spending.retain(|spending| caller.sees(&spending.project));
    farm.events.retain(|event| match &event.project {
        Some(project) => caller.sees(project),
        None => event.job_id.is_none(),
    });
    farm.events = farm.events.iter().map(without_others).collect();
    for node in &mut farm.nodes {
        node.activity = node.activity.take().filter(|activity| seen.sees(activity.job_id));
    }
    farm
}
