//! Plans and bookings.

use std::collections::BTreeMap;

use forelight_protocol::{
    Booking, BookingId, Event, EventKind, FrameForecast, FrameSet, JobId, JobState, JobVerdict, NodeId, Plan,
    PlanId, PlanReason, Timestamp,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::decode::{corrupt, id, id_opt, json, time, time_opt, to_json, whole, word};
use crate::events::{append, event, job_state};
use crate::live::{self, Occasion};
use crate::projection::{Holder, OpenBooking};
use crate::tasks::Common;
use crate::{JobForecast, NewSeed, QuoteBasis, Store, StoreError, calibration, forecasts, seeds};

/// A plan to be kept.
#[derive(Clone, PartialEq, Debug)]
pub struct NewPlan {
    /// The newest plan when this one was made.
    pub parent: Option<PlanId>,
    /// Why it was made.
    pub reason: PlanReason,
    /// Its word on the job that it books.
    pub verdict: JobVerdict,
    /// What it books.
    pub bookings: Vec<NewBooking>,
    /// The irradiance cache that the frames share and wait for, if they do.
    pub seed: Option<NewSeed>,
}

/// A booking of a plan to be kept.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NewBooking {
    /// The frame.
    pub frame: u32,
    /// The node.
    pub node: NodeId,
    /// From when.
    pub start: Timestamp,
    /// Until when (exclusive).
    pub end: Timestamp,
}

macro_rules! select_open {
    ($rest:literal) => {
        concat!(
            "SELECT b.*, t.state, t.node_id AS holder, t.started_at, t.progress FROM jobs j \
             JOIN bookings b ON b.plan_id = j.plan_id AND b.job_id = j.id \
             JOIN tasks t ON t.job_id = b.job_id AND t.kind = 'render' AND ifnull(t.frame, -1) = b.frame \
             WHERE j.state IN ('booked', 'rendering') AND t.state IN ('waiting', 'ready', 'leased') ",
            $rest
        )
    };
}

impl Store {
    /// Keeps a job's forecast and the plan that books it, and makes its render tasks: all of it or nothing. Without a `basis` nothing will be
    /// learnt from the forecast once the job is finished.
    ///
    /// A [`StoreError::Conflict`] if the job is not waiting for this (it was cancelled, or was booked before), or if
    /// another plan was kept since this one was begun, on whose bookings it may lie.
    pub async fn book(
        &self,
        job: JobId,
        forecast: &JobForecast,
        frames: &[FrameForecast],
        basis: Option<&QuoteBasis>,
        plan: &NewPlan,
        now: Timestamp,
    ) -> Result<PlanId, StoreError> {
        let mut write = self.write().await?;
        let row = sqlx::query("SELECT * FROM jobs WHERE id = ?")
            .bind(job.0)
            .fetch_optional(write.connection())
            .await?;
        let row = row.ok_or(StoreError::NotFound("job"))?;
        let state: JobState = word(&row, "state")?;
        if state != JobState::Profiling {
            return Err(StoreError::Conflict(format!("the job is {state}, not profiling")));
        }
        if newest(write.connection()).await? != plan.parent {
            return Err(StoreError::Conflict("another plan was kept in the meantime".to_owned()));
        }
        let plan_id = PlanId::new();
        sqlx::query("INSERT INTO plans (id, parent_id, reason, verdicts, created_at) VALUES (?, ?, ?, ?, ?)")
            .bind(plan_id.0)
            .bind(plan.parent.map(|parent| parent.0))
            .bind(reason_name(plan.reason))
            .bind(to_json(&[&plan.verdict])?)
            .bind(now.micros())
            .execute(write.connection())
            .await?;
        let mut booked = BTreeMap::new();
        for booking in &plan.bookings {
            sqlx::query("INSERT INTO bookings (id, plan_id, job_id, frame, node_id, start_at, end_at) VALUES (?, ?, ?, ?, ?, ?, ?)")
                .bind(BookingId::new().0)
                .bind(plan_id.0)
                .bind(job.0)
                .bind(i64::from(booking.frame))
                .bind(booking.node.0)
                .bind(booking.start.micros())
                .bind(booking.end.micros())
                .execute(write.connection())
                .await?;
            booked.insert(booking.frame, (booking.node, booking.start));
        }
        forecasts::keep_frames(&mut write, job, frames, &forecast.clock).await?;
        if let Some(basis) = basis {
            calibration::keep(&mut write, job, forecast, frames, basis).await?;
        }
        sqlx::query("UPDATE jobs SET state = 'booked', forecast = ?, plan_id = ?, verdict = ? WHERE id = ?")
            .bind(to_json(forecast)?)
            .bind(plan_id.0)
            .bind(to_json(&plan.verdict)?)
            .bind(job.0)
            .execute(write.connection())
            .await?;
        let mut common = Common::of(job, &row)?;
        let mut profiles: BTreeMap<_, _> =
            Self::profile_artifacts(write.connection(), job).await?.into_iter().collect();
        if let Some(spp) = forecast.chosen_spp.filter(|&spp| spp != common.settings.spp) {
            common.settings.spp = spp;
            sqlx::query("UPDATE jobs SET settings = ? WHERE id = ?")
                .bind(to_json(&common.settings)?)
                .bind(job.0)
                .execute(write.connection())
                .await?;
            // They belong to images of other samples.
            profiles.clear();
        }
        let job_frames: FrameSet =
            row.try_get::<&str, _>("frames")?.parse().map_err(|error| corrupt("frames", error))?;
        if let Some(seed) = &plan.seed {
            seeds::keep_bookings(&mut write, plan_id.0, job, &seed.bookings).await?;
            seeds::begin(&mut write, &common, seed).await?;
        }
        for frame in job_frames.iter() {
            // What was gathered for a cache of the frame's own is of no use beside one that is shared.
            let profile = profiles.get(&frame).copied().filter(|_| plan.seed.is_none());
            common
                .render(&mut write, frame, plan.seed.is_some(), booked.get(&frame).copied(), profile)
                .await?;
        }
        live::update(&mut write, job, Occasion::Booked, now).await?;
        append(&mut write, Event { job_id: Some(job), ..event(EventKind::ForecastReady, now) }).await?;
        append(
            &mut write,
            Event { job_id: Some(job), plan_id: Some(plan_id), ..event(EventKind::PlanStored, now) },
        )
        .await?;
        job_state(&mut write, job, JobState::Booked, None, now).await?;
        self.commit(write).await?;
        Ok(plan_id)
    }

    /// The newest plan; `None` before the first.
    pub async fn newest_plan(&self) -> Result<Option<PlanId>, StoreError> {
        let mut connection = self.readers().acquire().await?;
        newest(&mut connection).await
    }

    /// A plan.
    pub async fn plan(&self, plan: PlanId) -> Result<Plan, StoreError> {
        let mut transaction = self.read().await?;
        let row = sqlx::query("SELECT * FROM plans WHERE id = ?")
            .bind(plan.0)
            .fetch_optional(&mut *transaction)
            .await?;
        let row = row.ok_or(StoreError::NotFound("plan"))?;
        let bookings = sqlx::query("SELECT * FROM bookings WHERE plan_id = ? ORDER BY start_at, id")
            .bind(plan.0)
            .fetch_all(&mut *transaction)
            .await?;
        let seeds = seeds::of_plan(&mut transaction, plan.0).await?;
        Ok(Plan {
            id: plan,
            parent_id: id_opt(&row, "parent_id")?.map(PlanId),
            reason: word(&row, "reason")?,
            created_at: time(&row, "created_at")?,
            verdicts: json(&row, "verdicts")?,
            bookings: bookings.iter().map(decode_booking).collect::<Result<_, _>>()?,
            seeds,
        })
    }

    /// The bookings of frames that are not rendered yet, by start.
    pub async fn open_bookings(&self) -> Result<Vec<OpenBooking>, StoreError> {
        let mut connection = self.readers().acquire().await?;
        open(&mut connection).await
    }

    /// The open bookings that start after `after` (or with it, and have a greater id), by start, at most `limit`.
    pub async fn open_bookings_page(
        &self,
        after: Option<(Timestamp, BookingId)>,
        limit: u32,
    ) -> Result<Vec<Booking>, StoreError> {
        let (start, id) = after.map_or((i64::MIN, uuid::Uuid::nil()), |(start, id)| (start.micros(), id.0));
        let rows =
            sqlx::query(select_open!("AND (b.start_at, b.id) > (?, ?) ORDER BY b.start_at, b.id LIMIT ?"))
                .bind(start)
                .bind(id)
                .bind(limit)
                .fetch_all(self.readers())
                .await?;
        rows.iter().map(decode_booking).collect()
    }
}

async fn newest(connection: &mut SqliteConnection) -> Result<Option<PlanId>, StoreError> {
    // By row number, not by id: ids sort by the clock, and the clock may have been set back.
    let id = sqlx::query_scalar("SELECT id FROM plans ORDER BY rowid DESC LIMIT 1")
        .fetch_optional(connection)
        .await?;
    Ok(id.map(PlanId))
}

pub(crate) async fn open(connection: &mut SqliteConnection) -> Result<Vec<OpenBooking>, StoreError> {
    let rows = sqlx::query(select_open!("ORDER BY b.start_at, b.id")).fetch_all(connection).await?;
    rows.iter().map(decode_open).collect()
}

/// The bookings of a job's frames that are not rendered yet, by start.
pub(crate) async fn open_of(
    connection: &mut SqliteConnection,
    job: JobId,
) -> Result<Vec<OpenBooking>, StoreError> {
    let rows = sqlx::query(select_open!("AND j.id = ? ORDER BY b.start_at, b.id"))
        .bind(job.0)
        .fetch_all(connection)
        .await?;
    rows.iter().map(decode_open).collect()
}

fn decode_open(row: &SqliteRow) -> Result<OpenBooking, StoreError> {
    let leased = row.try_get::<&str, _>("state")? == "leased";
    let holder = match (leased, id_opt(row, "holder")?, time_opt(row, "started_at")?) {
        (true, Some(node), Some(started)) => {
            Some(Holder { node_id: NodeId(node), started, progress: row.try_get("progress")? })
        }
        _ => None,
    };
    Ok(OpenBooking { booking: decode_booking(row)?, holder })
}

fn decode_booking(row: &SqliteRow) -> Result<Booking, StoreError> {
    Ok(Booking {
        id: BookingId(id(row, "id")?),
        plan_id: PlanId(id(row, "plan_id")?),
        job_id: JobId(id(row, "job_id")?),
        frame: whole(row, "frame")?,
        node_id: NodeId(id(row, "node_id")?),
        start: time(row, "start_at")?,
        end: time(row, "end_at")?,
    })
}

fn reason_name(reason: PlanReason) -> &'static str {
    match reason {
        PlanReason::JobForecast => "job_forecast",
    }
}
