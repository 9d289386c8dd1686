//! The living estimate of a job. It is updated as frames are finished, in the transaction that stores their
//! cost.
//!
//! [`forelight_quote::living`] computes the estimate and decides when it is due. This module reads its input,
//! compares it with the booking, and stores it.
//!
//! The row also stores whether the estimate has left the booking. So leaving and coming back are one event
//! each, in the same transaction. A new plan books the estimate of its time. An estimate that plans should
//! take into account calls for a new plan.

mod frames;
mod rows;

use forelight_protocol::{
    Booked, Confidence, Event, EventKind, JobId, JobVerdict, LiveForecast, MoneyQuantiles, PlanId, Quantiles,
    SharedCacheProgress, Timestamp,
};
use forelight_quote::living::{self, Baseline, Comparison, Estimate, Frames, Off, is_due};
use sqlx::SqliteConnection;

use self::rows::{Before, Kept, count_frame, keep};
use crate::budgets::ledger;
use crate::columns::Time;
use crate::database::Write;
use crate::error::Result;
use crate::events::{append, event};
use crate::plans::{bookings, replans};
use crate::policy::projection::{frames_of, project, stretched};
use crate::shared_cache::parts;
use forelight_quote::JobForecast;

pub(crate) use self::rows::{before, newest};
pub(crate) use forelight_quote::living::Occasion;

/// Updates the estimate inside a write, if it is due.
pub(crate) async fn update(write: &mut Write, job: JobId, occasion: Occasion, now: Timestamp) -> Result<()> {
    let before = before(write, job).await?;
    update_after(before, write, job, occasion, now).await
}

/// As [`update`], for a caller that has read [`Before`].
pub(crate) async fn update_after(
    before: Before,
    write: &mut Write,
    job: JobId,
    occasion: Occasion,
    now: Timestamp,
) -> Result<()> {
    if let Some(kept) = &before.estimate
        && !is_due(&kept.last, occasion, now)
    {
        if occasion == Occasion::Frame {
            count_frame(write, job);
        }
        return Ok(());
    }
    let Some(quoted) = Quoted::read(write.connection().await?, job).await? else { return Ok(()) };
    let frames = frames::read(write.connection().await?, job, &quoted.forecast.lights).await?;
    let is_over = before.job_state.is_final();
    let is_given_up = is_over && !frames.all_done;
    let estimate = Estimate::new(&quoted.forecast.total, &frames, is_given_up);
    let baseline = baseline(before.estimate.as_ref(), &quoted, &estimate);
    let finish = if frames.all_done || is_over {
        Some(now)
    } else {
        let expected = estimate.cpu_seconds.remaining.at(quoted.confidence);
        let stretch = baseline.stretch(frames.share_left, expected);
        expected_finish(write.connection().await?, job, &frames, stretch, now).await?
    };
    // What was said last, also of an earlier plan, so that events about a quantity alternate. A new plan is
    // compared with afresh.
    let was_told = before.estimate.as_ref().map(|kept| kept.was_off).unwrap_or_default();
    let was_off = before.estimate.filter(|kept| kept.plan == quoted.plan).map(|kept| kept.was_off);
    let was_off = was_off.unwrap_or_default();
    let booked = quoted.booked(&baseline);
    let delay = delay_that_counts(write.connection().await?, quoted.plan, job, booked.finish).await?;
    let cost = cost(write.connection().await?, job, &quoted.forecast, &estimate, is_given_up, now).await?;
    let frames_done = frames.done;
    let live = Comparison { at: now, frames_done, estimate, cost, finish, booked, delay, was_off }.live();
    if !is_given_up {
        tell(write, job, quoted.plan, &live, was_told);
    }
    if !is_over && let Some(cause) = living::cause_of_plan(&live, was_off, quoted.factor, &quoted.job_name) {
        replans::want(write, &cause).await?;
    }
    keep(write, job, quoted.plan, &baseline, &live).await
}

/// Updates estimates that have left out a finished frame for a while.
pub(crate) async fn catch_up(write: &mut Write, now: Timestamp) -> Result<()> {
    let behind = sqlx::query_scalar!(
        "SELECT job_id FROM live_forecasts INDEXED BY live_forecasts_behind WHERE frames_since > 0 \
         AND updated_at <= ? ORDER BY updated_at, job_id",
        now.plus_micros(-living::BETWEEN_PIXELS).micros()
    )
    .fetch_all(write.connection().await?)
    .await?;
    for job in behind {
        update(write, job.into(), Occasion::Meanwhile, now).await?;
    }
    Ok(())
}

struct Quoted {
    job_name: String,
    /// The factor that its plan applied to the forecast.
    factor: f64,
    forecast: JobForecast,
    plan: PlanId,
    verdict: Option<JobVerdict>,
    confidence: Confidence,
}

impl Quoted {
    /// `None` for a job that is not booked.
    async fn read(connection: &mut SqliteConnection, job: JobId) -> Result<Option<Self>> {
        let row = sqlx::query!(
            "SELECT name, factor, forecast, verdict, confidence, plan_id FROM jobs WHERE id = ?",
            job.0
        )
        .fetch_one(connection)
        .await?;
        let (Some(forecast), Some(plan)) = (row.forecast, row.plan_id) else {
            return Ok(None);
        };
        Ok(Some(Self {
            job_name: row.name,
            factor: row.factor,
            forecast: forecast.read()?,
            plan: plan.into(),
            verdict: row.verdict.map(|it| it.0),
            confidence: row.confidence.0,
        }))
    }

    fn booked(&self, baseline: &Baseline) -> Booked {
        Booked {
            confidence: self.confidence,
            cpu_seconds: baseline.cpu_seconds,
            cost: self.verdict.as_ref().and_then(|verdict| verdict.cost),
            finish: self.verdict.as_ref().and_then(|verdict| verdict.finish),
        }
    }
}

/// The cost that the job's plan was made for: the quote, if there was no estimate before the plan.
fn baseline(before: Option<&Kept>, quoted: &Quoted, estimate: &Estimate) -> Baseline {
    match before {
        Some(kept) if kept.plan == quoted.plan => kept.baseline,
        Some(kept) => Baseline::of_estimate(&kept.cpu_seconds, quoted.confidence),
        None => Baseline::of_quote(&estimate.cpu_seconds.quote, quoted.confidence),
    }
}

/// When the job's last frame is expected if bookings are longer by this factor; `None` without bookings, and while
/// some are held.
async fn expected_finish(
    connection: &mut SqliteConnection,
    job: JobId,
    frames: &Frames,
    stretch: f64,
    now: Timestamp,
) -> Result<Option<Timestamp>> {
    let bookings = bookings::open_of(connection, job).await?;
    let free: Vec<_> = bookings.into_iter().filter(|open| !open.held).collect();
    if frames_of(&free) + (frames.done as usize) < frames.count() {
        return Ok(None);
    }
    let parts = parts::open_of(connection, job).await?;
    Ok(project(&stretched(&free, stretch), &parts, now).finish_of(job))
}

/// The job's cost in money; `None` if it was quoted without a price.
async fn cost(
    connection: &mut SqliteConnection,
    job: JobId,
    quote: &JobForecast,
    estimate: &Estimate,
    is_given_up: bool,
    now: Timestamp,
) -> Result<Option<MoneyQuantiles>> {
    let Some(price) = quote.cost else { return Ok(None) };
    let for_cache = quote.shared_cache_seconds();
    let cache = match parts::progress(connection, job).await? {
        _ if is_given_up => Quantiles::default(),
        None => for_cache,
        Some(SharedCacheProgress { ready: true, .. }) => Quantiles::default(),
        Some(SharedCacheProgress { cpu_seconds, .. }) => for_cache.less(cpu_seconds),
    };
    let spent = ledger::spent_on(connection, job, now).await?;
    let quoted = quote.total.cpu_seconds.mean + for_cache.mean;
    Ok(living::cost(&estimate.cpu_seconds.remaining, &cache, (price, quoted), spent))
}

/// How many microseconds after its booked end the job counts as late.
async fn delay_that_counts(
    connection: &mut SqliteConnection,
    plan: PlanId,
    job: JobId,
    finish: Option<Timestamp>,
) -> Result<i64> {
    let begin = sqlx::query_scalar!(
        r#"SELECT min(start_at) AS "begin?: Time" FROM bookings WHERE plan_id = ? AND job_id = ?"#,
        plan.0,
        job.0
    )
    .fetch_one(connection)
    .await?;
    Ok(living::delay_that_counts(begin.map(Into::into), finish))
}

/// Writes an event for each figure that left the booking or came back to it.
fn tell(write: &mut Write, job: JobId, plan: PlanId, live: &LiveForecast, was_off: Off) {
    for living::News { is_off, message, off } in living::news(live, was_off) {
        let kind = if is_off { EventKind::JobOffForecast } else { EventKind::JobOnForecast };
        append(
            write,
            Event {
                job_id: Some(job),
                plan_id: Some(plan),
                off_forecast: Some(off),
                message: Some(message),
                ..event(kind, live.at)
            },
        );
    }
}
