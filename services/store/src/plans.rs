//! Stores plans and books their jobs.

pub(crate) mod bookings;
pub(crate) mod farm_jobs;
pub(crate) mod reading;
pub(crate) mod replans;
pub(crate) mod slowness;

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{
    BookingId, CacheMode, Event, EventKind, FrameForecast, FramePart, JobId, JobNews, JobSettings, JobState,
    JobVerdict, NodeId, PlanId, PlanReason, Timestamp, Waits,
};
use forelight_quote::{JobForecast, QuoteBasis};

use crate::columns::{Json, hex};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{append, event, job_state};
use crate::jobs::outlooks::{self, FinishSpread, JobOutlook};
use crate::jobs::serial_time;
use crate::living::{self, Occasion};
use crate::plans::reading::newest;
use crate::plans::replans::Wanted;
use crate::policy::rebooking::{NewBooking, Rebooked, rebook};
use crate::quotes;
use crate::shared_cache::{self, NewSharedCache, parts};
use crate::tasks::{Common, Finished, RenderAsked, rates};
use crate::writing::run;
use crate::{division, jobs, nodes};

/// A plan to store.
#[derive(Clone, PartialEq, Debug)]
pub struct NewPlan {
    /// The newest plan when this one was made.
    pub parent: Option<PlanId>,
    /// Why it was made.
    pub reason: PlanReason,
    /// The causes that it takes into account.
    pub wanted: Wanted,
    /// The jobs that it books. All others keep their bookings.
    pub jobs: Vec<NewJobPlan>,
    /// New outlooks of jobs: why they wait, and the state of their promises.
    pub outlooks: Vec<(JobId, JobOutlook)>,
    /// How the end of all bookings varies in the scenarios of the plan.
    pub finish: Option<FinishSpread>,
    /// The irradiance cache that the frames of a newly booked job wait for; `None` if they share none.
    pub shared_cache: Option<NewSharedCache>,
}

/// A job in a plan to store.
#[derive(Clone, PartialEq, Debug)]
pub struct NewJobPlan {
    /// The plan's verdict.
    pub verdict: JobVerdict,
    /// Bookings of its frames that wait for a worker. All other frames keep their bookings.
    pub bookings: Vec<NewBooking>,
    /// Its frames, and parts of frames, that had begun when the plan was made. One that waits again by now keeps its booking.
    pub begun: BTreeSet<FramePart>,
    /// The factor that the plan applies to its forecast.
    pub factor: f64,
    /// The version of its terms that the plan was made for, see [`crate::FarmJob::terms`].
    pub terms: i64,
}

impl Store {
    /// Stores a job's forecast and the plan that books it, and makes its render tasks, in one transaction.
    /// The plan may rebook other jobs, too. Without a `basis`, nothing is learnt from the forecast when the
    /// job is finished.
    ///
    /// Of a job that was accepted, the forecast is stored already and stays.
    ///
    /// A [`StoreError::Conflict`] if the job is neither `profiling` nor accepted (it was cancelled or booked
    /// before), or if another plan was stored since this one was begun: their bookings could overlap.
    pub async fn book(
        &self,
        job: JobId,
        forecast: &JobForecast,
        frames: &[FrameForecast],
        basis: Option<&QuoteBasis>,
        plan: &NewPlan,
        now: Timestamp,
    ) -> Result<PlanId> {
        let mut write = self.write().await?;
        let row = jobs::row(write.connection().await?, job).await?;
        let state = row.state.0;
        match state {
            JobState::Profiling => quotes::keep(&mut write, job, forecast, frames, basis, now).await?,
            JobState::Quoted if !row.hold => {}
            other => return Err(StoreError::Conflict(format!("the job is {other} and is not to be booked"))),
        }
        let mut common = Common::of(&row);
        let mut finished: BTreeMap<u32, Finished> =
            Self::finished_by_profiles(write.connection().await?, job).await?.into_iter().collect();
        if let (Some(spp), JobSettings::Own(settings)) = (forecast.chosen_spp, &mut common.settings) {
            if common.error_target.is_none() {
                settings.spp = spp;
            }
            // Profiled pixels belong to images with the same number of samples in every pixel. With an error
            // target, an irradiance cache was filled for them, which the frame can use.
            if common.error_target.is_none() || settings.cache == CacheMode::Off {
                finished.clear();
            }
        }
        let work: BTreeMap<u32, u64> = match forecast.chosen_spp {
            Some(_) => frames.iter().map(|each| (each.frame, each.work.mean.round() as u64)).collect(),
            None => BTreeMap::new(),
        };
        let waits = plan.shared_cache.is_some();
        for frame in row.frame_set()?.iter() {
            // With a shared cache, the records of a profile's own cache are of no use.
            let finished = finished.remove(&frame).filter(|_| !waits).unwrap_or_default();
            let asked = RenderAsked { frame, work: work.get(&frame).copied(), finished };
            common.render(&mut write, asked, waits).await?;
        }
        let renderer = row.renderer.as_ref().map(|Json(renderer)| renderer.name.as_str());
        serial_time::expect(&mut write, job, renderer, forecast.mean_of_frames(frames.len())).await?;
        let plan_id = keep(&mut write, plan, Some(job), now).await?;
        if let Some(cache) = &plan.shared_cache {
            parts::keep_bookings(&mut write, plan_id.0, job, &cache.bookings).await?;
            shared_cache::begin(&mut write, &common, cache).await?;
        }
        let booked =
            run!(write, "UPDATE jobs SET stage = 'booked' WHERE id = ? AND plan_id = ?", job.0, plan_id.0);
        if booked != 1 {
            return Err(StoreError::Conflict("the plan does not book the job".to_owned()));
        }
        living::update(&mut write, job, Occasion::Booked, now).await?;
        job_state(&mut write, job, JobState::Booked, None, now);
        // A booked job has its promise, whatever happens to the outlooks of the others.
        self.tell_outlooks(write, plan, Some(job), Some(plan_id), now).await?;
        Ok(plan_id)
    }

    /// Stores a new plan. A [`StoreError::Conflict`] if another plan came first, or if one of its jobs is
    /// over.
    pub async fn replan(&self, plan: &NewPlan, now: Timestamp) -> Result<PlanId> {
        let mut write = self.write().await?;
        let plan_id = keep(&mut write, plan, None, now).await?;
        self.tell_outlooks(write, plan, None, Some(plan_id), now).await?;
        Ok(plan_id)
    }

    /// Stores only new outlooks, for a plan that changes no booking.
    pub async fn keep_outlooks(&self, plan: &NewPlan, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        check_newest(&mut write, plan.parent).await?;
        self.tell_outlooks(write, plan, None, plan.parent, now).await
    }

    /// Stores the outlooks of a plan, that of job `first` before the others, and that it was made, while
    /// `newest_plan` is the newest.
    ///
    /// A farm has thousands of jobs, and workers wait while somebody writes. So the open write takes the first
    /// outlooks, and several short ones the others. If they end half-way, the causes stay due, and the next plan
    /// stores the rest.
    async fn tell_outlooks(
        &self,
        mut write: Write,
        plan: &NewPlan,
        first: Option<JobId>,
        newest_plan: Option<PlanId>,
        now: Timestamp,
    ) -> Result<()> {
        let mut outlooks: Vec<&(JobId, JobOutlook)> = plan.outlooks.iter().collect();
        outlooks.sort_by_key(|(of, _)| Some(*of) != first);
        let mut parts = outlooks.chunks(OUTLOOKS_AT_ONCE).peekable();
        loop {
            outlooks::keep(&mut write, parts.next().unwrap_or_default(), now).await?;
            if parts.peek().is_none() {
                outlooks::keep_of_farm(&mut write, plan.finish).await?;
                replans::planned(&mut write, &plan.wanted).await?;
                return self.commit(write).await;
            }
            self.commit(write).await?;
            write = self.write().await?;
            check_newest(&mut write, newest_plan).await?;
        }
    }
}

/// A [`StoreError::Conflict`] if this plan is not the newest any more.
async fn check_newest(write: &mut Write, plan: Option<PlanId>) -> Result<()> {
    if newest(write.connection().await?).await? == plan {
        return Ok(());
    }
    Err(StoreError::Conflict("another plan was stored in the meantime".to_owned()))
}

/// Outlooks that are stored in one write.
const OUTLOOKS_AT_ONCE: usize = 100;

/// Stores a plan inside a write: its jobs and their tasks get its bookings. `fresh` is a job without a plan.
async fn keep(write: &mut Write, plan: &NewPlan, fresh: Option<JobId>, now: Timestamp) -> Result<PlanId> {
    check_newest(write, plan.parent).await?;
    let plan_id = PlanId::new();
    let verdicts: Vec<&JobVerdict> = plan.jobs.iter().map(|job| &job.verdict).collect();
    run!(
        write,
        "INSERT INTO plans (id, parent_id, reason, causes, verdicts, created_at) VALUES (?, ?, ?, ?, ?, ?)",
        plan_id.0,
        plan.parent.map(|parent| parent.0),
        plan.reason.name(),
        Json(&plan.wanted.causes),
        Json(&verdicts),
        now.micros()
    );
    let outlooks: BTreeMap<JobId, &JobOutlook> =
        plan.outlooks.iter().map(|(job, outlook)| (*job, outlook)).collect();
    for job in &plan.jobs {
        let job_id = job.verdict.job_id;
        if fresh != Some(job_id) {
            let state = jobs::state(write.connection().await?, job_id).await?;
            if !state.is_booked() {
                return Err(StoreError::Conflict(format!("job {job_id} needs no plan: it is {state}")));
            }
        }
        keep_job(write, plan_id, job).await?;
        if fresh != Some(job_id) {
            living::update(write, job_id, Occasion::Booked, now).await?;
        }
        let outlook = outlooks.get(&job_id);
        let waits = outlook
            .and_then(|outlook| outlook.waits.clone())
            .filter(|waits| job.begun.is_empty() || waits.is_held());
        // What is held has no end, whatever is booked.
        let eta = job.verdict.finish.filter(|_| !waits.as_ref().is_some_and(Waits::is_held));
        let spread = outlook.and_then(|outlook| outlook.finish).zip(eta);
        let news = JobNews {
            verdict: Some(job.verdict.verdict),
            eta,
            finish: spread.map(|(spread, end)| spread.around(end, now)),
            booked_cost: job.verdict.cost,
            probability: outlook.and_then(|outlook| outlook.probability),
            waits,
            ..JobNews::default()
        };
        let told = Event {
            job_id: Some(job_id),
            plan_id: Some(plan_id),
            job: Some(news.into()),
            ..event(EventKind::PlanStored, now)
        };
        let message = (!plan.wanted.causes.is_empty()).then(|| plan.wanted.causes.join("; "));
        append(write, Event { message, ..told });
    }
    Ok(plan_id)
}

/// Books one job of a plan: waiting frames as the plan says, all others as before.
async fn keep_job(write: &mut Write, plan: PlanId, job: &NewJobPlan) -> Result<()> {
    let job_id = job.verdict.job_id;
    division::divide_as_planned(write, job_id, &job.bookings).await?;
    let before = bookings_before(write, job_id).await?;
    let waiting = waiting(write, job_id).await?;
    let Rebooked { bookings, tasks } = rebook(before, &waiting, &job.bookings, &job.begun);
    book_tasks(write, job_id, tasks).await?;
    // A farm books hundreds of thousands of frames anew at times, and everybody waits: so all rows are one statement.
    let rows: Vec<_> = bookings
        .into_values()
        .map(|NewBooking { frame: FramePart { frame, part, parts }, node, start, end }| {
            (hex(BookingId::new().0), frame, part, parts, hex(node.0), start.micros(), end.micros())
        })
        .collect();
    run!(
        write,
        "INSERT INTO bookings (plan_id, job_id, id, frame, part, parts, node_id, start_at, end_at) \
         SELECT ?, ?, unhex(b.value ->> 0), b.value ->> 1, b.value ->> 2, b.value ->> 3, unhex(b.value ->> 4), \
         b.value ->> 5, b.value ->> 6 FROM json_each(?) b",
        plan.0,
        job_id.0,
        Json(&rows)
    );
    // Parts of a shared cache keep their bookings.
    run!(
        write,
        "INSERT INTO shared_cache_bookings (plan_id, job_id, part, node_id, start_at, end_at) \
         SELECT ?1, b.job_id, b.part, b.node_id, b.start_at, b.end_at FROM shared_cache_bookings b \
         JOIN jobs j ON j.plan_id = b.plan_id AND j.id = b.job_id WHERE j.id = ?2",
        plan.0,
        job_id.0
    );
    run!(
        write,
        "UPDATE jobs SET plan_id = ?, verdict = ?, factor = ?, terms_planned = ? WHERE id = ?",
        plan.0,
        Json(&job.verdict),
        job.factor,
        job.terms,
        job_id.0
    );
    Ok(())
}

/// A job's frames and parts of frames that wait for a worker.
async fn waiting(write: &mut Write, job: JobId) -> Result<Vec<FramePart>> {
    let rows = sqlx::query!(
        r#"SELECT t.frame AS "frame!: u32", t.booked_part AS "part!: u32", f.parts AS "parts!: u32" FROM tasks t
           JOIN frames f ON f.job_id = t.job_id AND f.frame = t.frame
           WHERE t.job_id = ? AND t.booked_part IS NOT NULL AND t.state IN ('waiting', 'ready') ORDER BY t.frame, t.booked_part"#,
        job.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    Ok(rows.into_iter().map(|row| FramePart { frame: row.frame, part: row.part, parts: row.parts }).collect())
}

/// The bookings of the job's present plan. Those of a frame that was divided since are left out; where a part
/// was divided again, the others keep theirs.
async fn bookings_before(write: &mut Write, job: JobId) -> Result<BTreeMap<FramePart, NewBooking>> {
    let rows = sqlx::query!(
        "SELECT b.frame, b.part, f.parts, b.node_id, b.start_at, b.end_at FROM bookings b \
         JOIN jobs j ON j.plan_id = b.plan_id AND j.id = b.job_id \
         JOIN frames f ON f.job_id = b.job_id AND f.frame = b.frame AND (f.parts = b.parts OR b.parts > 1) WHERE j.id = ?",
        job.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    let bookings = rows.into_iter().map(|row| {
        let (node, start, end) = (row.node_id.into(), row.start_at.into(), row.end_at.into());
        let frame = FramePart { frame: row.frame, part: row.part, parts: row.parts };
        (frame, NewBooking { frame, node, start, end })
    });
    Ok(bookings.collect())
}

/// Writes to the tasks of these frames and parts where they are booked, with the job's rate on each node.
pub(crate) async fn book_tasks(
    write: &mut Write,
    job: JobId,
    tasks: Vec<(FramePart, Option<NewBooking>)>,
) -> Result<()> {
    let of_job = rates(write.connection().await?, job).await?;
    let booked: BTreeSet<NodeId> =
        tasks.iter().filter_map(|(_, booking)| booking.as_ref()).map(|booking| booking.node).collect();
    let nodes = nodes::by_ids(write.connection().await?, booked).await?;
    let rows = tasks.into_iter().map(|(FramePart { frame, part, .. }, booking)| {
        let node = booking.as_ref().map(|booking| booking.node);
        let rate = node.and_then(|node| of_job.on(nodes.get(&node)?));
        (frame, part, node.map(|node| hex(node.0)), booking.map(|booking| booking.start.micros()), rate)
    });
    let rows: Vec<_> = rows.collect();
    run!(
        write,
        "UPDATE tasks SET booked_node = unhex(b.value ->> 2), booked_at = b.value ->> 3, booked_rate = b.value ->> 4 \
         FROM json_each(?2) b WHERE tasks.id = (SELECT t.id FROM tasks t INDEXED BY tasks_of_bookings \
         WHERE t.job_id = ?1 AND t.frame = b.value ->> 0 AND t.booked_part = b.value ->> 1)",
        job.0,
        Json(&rows)
    );
    Ok(())
}
