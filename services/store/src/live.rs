//! The living estimate of a job: made again as its frames are finished, in the transaction that keeps what they took.
//!
//! *How often.* An estimate reads all frames of the job, so it takes time in proportion to their number. It is made with each of the first
//! [`FIRST`] frames, then with every 256th part of the job but not twice within [`BETWEEN_FRAMES`], and with the last: a job of n frames reads at most about
//! 270 n rows for it in all its life, 5,000 frames a few milliseconds each 20th, and frames that come in thousands a second wait for no estimates. Finished
//! pixels of frames under way move it as well, at most each [`BETWEEN_PIXELS`]; frames that came since the last estimate are taken by the sweep after as long.
//!
//! *Events.* Whether the estimate has left what is booked is remembered with it, so that leaving and coming back are each said once, in the same
//! transaction. When a new plan books the job, what is booked is what was expected when it was made. An estimate that is news to the plan calls for
//! a new one.

mod frames;
mod kept;

use forelight_forecast::{Band, LiveFrame, Measure, live};
use forelight_protocol::{
    Booked, BookedQuantity, Confidence, Event, EventKind, JobId, JobVerdict, LiveFigure, LiveForecast, Money,
    OffForecast, PlanId, Quantiles, SeedProgress, Timestamp,
};
use forelight_quote::JobForecast;
use sqlx::{Row as _, SqliteConnection};

use self::frames::Frames;
use self::kept::{Before, Kept, count_frame, keep};
use crate::database::Write;
use crate::decode::{id_opt, json_opt, word};
use crate::events::{append, event};
use crate::projection::{OpenBooking, project};
use crate::replans::{self, is_news};
use crate::{StoreError, bookings, budgets, seeds};

#[cfg(test)]
pub(crate) use self::frames::FRAMES;
pub(crate) use self::kept::{before, newest};

/// With each of the first frames there is a new estimate.
const FIRST: u32 = 16;

/// Afterwards with each part of the job, if that is more than a frame.
const PARTS: u32 = 256;

/// Time between two estimates, the first ones and the last excepted: a second, in microseconds.
const BETWEEN_FRAMES: i64 = 1_000_000;

/// Time between two estimates that rest on nothing but more finished pixels, or on fewer frames than a part: ten seconds, in microseconds.
const BETWEEN_PIXELS: i64 = 10_000_000;

/// So much above what is booked the estimate has left it: less is no news, and a plan that is met exactly would be left and met with every frame.
const MARGIN: f64 = 0.02;

/// And the job ends at least so much later, in microseconds: a second.
const LEAST_DELAY: i64 = 1_000_000;

/// Why there may be a new estimate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Occasion {
    /// The job was booked.
    Booked,
    /// A frame was finished.
    Frame,
    /// The job was cancelled, or failed.
    Ended,
    /// Some pixels of a frame were, or there are frames that were left for the next estimate.
    Meanwhile,
}

/// Makes the estimate again, if it is time to, inside a write.
pub(crate) async fn update(
    write: &mut Write,
    job: JobId,
    occasion: Occasion,
    now: Timestamp,
) -> Result<(), StoreError> {
    let before = before(write, job).await?;
    update_after(before, write, job, occasion, now).await
}

/// As [`update`], for who has asked what there was before.
pub(crate) async fn update_after(
    before: Before,
    write: &mut Write,
    job: JobId,
    occasion: Occasion,
    now: Timestamp,
) -> Result<(), StoreError> {
    let Before { estimate: kept, job_state: state } = before;
    if let Some(kept) = &kept
        && !kept.is_due(occasion, now)
    {
        if occasion == Occasion::Frame {
            count_frame(write, job);
        }
        return Ok(());
    }
    let row =
        sqlx::query("SELECT name, factor, forecast, verdict, confidence, plan_id FROM jobs WHERE id = ?")
            .bind(job.0)
            .fetch_one(write.connection().await?)
            .await?;
    let (Some(quote), Some(plan)) =
        (json_opt::<JobForecast>(&row, "forecast")?, id_opt(&row, "plan_id")?.map(PlanId))
    else {
        return Ok(());
    };
    let confidence: Confidence = word(&row, "confidence")?;
    let verdict: Option<JobVerdict> = json_opt(&row, "verdict")?;
    let frames = Frames::read(write.connection().await?, job, &quote.lights).await?;
    let mut work = figure(&quote.total.work, &frames.work, Measure::Work);
    let mut cpu = figure(&quote.total.cpu_seconds, &frames.cpu, Measure::CpuTime);
    // Nothing will come of what is left of a job that was cancelled or failed.
    let is_given_up = state.is_final() && !frames.all_done;
    if is_given_up {
        [&mut work, &mut cpu].into_iter().for_each(LiveFigure::give_up);
    }

    // What the plan was made for: the estimate before this one if it is a new plan, the quote if there was none.
    let [booked_cpu, booked_rest, booked_share] = match &kept {
        Some(kept) if kept.plan == plan => [kept.booked_cpu, kept.booked_rest, kept.booked_share],
        Some(Kept { body, .. }) => {
            let Quantiles { p50, .. } = body.cpu_seconds.quote;
            let left = body.cpu_seconds.remaining.p50 / body.cpu_seconds.factor;
            let share = if p50 > 0.0 { (left / p50).clamp(0.0, 1.0) } else { 1.0 };
            [body.cpu_seconds.whole.at(confidence), body.cpu_seconds.remaining.at(confidence), share]
        }
        None => [cpu.quote.at(confidence), cpu.quote.at(confidence), 1.0],
    };
    let booked = Booked {
        confidence,
        cpu_seconds: booked_cpu,
        cost: verdict.as_ref().and_then(|verdict| verdict.cost),
        finish: verdict.as_ref().and_then(|verdict| verdict.finish),
    };
    let stretch = {
        let rest = if booked_share > 0.0 { booked_rest * frames.share_left / booked_share } else { 0.0 };
        if rest > 0.0 { cpu.remaining.at(confidence) / rest } else { 1.0 }
    };
    let bookings = bookings::open_of(write.connection().await?, job).await?;
    let finish = if frames.all_done || state.is_final() {
        Some(now)
    } else {
        let seeds = seeds::open_of(write.connection().await?, job).await?;
        let all_booked = bookings.len() + frames.done as usize >= frames.cpu.len();
        project(&stretched(&bookings, stretch), &seeds, now).finish_of(job).filter(|_| all_booked)
    };
    let same_plan = kept.as_ref().filter(|kept| kept.plan == plan);
    let was_off = same_plan.map_or([false; 2], |kept| [kept.cost_is_off, kept.finish_is_off]);
    let delay = delay_that_counts(write.connection().await?, plan, job, booked.finish).await?;
    let expected = cpu.whole.at(confidence);
    let cost = match price(&quote) {
        None => None,
        Some(price) => {
            let connection = write.connection().await?;
            let cache = if is_given_up {
                Quantiles::default()
            } else {
                shared_cache_left(connection, job, &quote).await?
            };
            let left = cpu.remaining.plus(&cache);
            Some(left.in_money(price).plus(budgets::spent_on(connection, job, now).await?))
        }
    };
    let live = LiveForecast {
        at: now,
        frames_done: frames.done,
        work,
        cpu_seconds: cpu,
        cost,
        finish,
        booked,
        cost_is_off: is_off(was_off[0], expected, booked_cpu, MARGIN * booked_cpu),
        finish_is_off: match (finish, booked.finish) {
            (Some(finish), Some(booked)) => {
                is_off(was_off[1], finish.micros_since(booked) as f64, 0.0, delay as f64)
            }
            _ => false,
        },
    };
    if !is_given_up {
        tell(write, job, plan, &live, was_off).await?;
    }
    if !state.is_final()
        && (is_news(live.cpu_seconds.factor, row.try_get("factor")?) || (live.finish_is_off && !was_off[1]))
    {
        let name: &str = row.try_get("name")?;
        let word = if live.cpu_seconds.factor < 1.0 { "less" } else { "longer" };
        let cause = format!("frames of job {name} take {word} than was forecast");
        replans::want(write, &cause).await?;
    }
    let baseline = [booked_cpu, booked_rest, booked_share];
    keep(write, job, plan, baseline, &live).await
}

impl Kept {
    fn is_due(&self, occasion: Occasion, now: Timestamp) -> bool {
        let age = now.micros_since(self.updated_at);
        match occasion {
            Occasion::Booked | Occasion::Ended => true,
            Occasion::Frame => {
                let since = self.frames_since + 1;
                let done = self.frames_done + since;
                let total = self.frames_total;
                let is_part = since >= (total / PARTS).max(1) && age >= BETWEEN_FRAMES;
                done <= FIRST || done >= total || is_part
            }
            Occasion::Meanwhile => age >= BETWEEN_PIXELS,
        }
    }
}

/// Makes the estimates again that have not known of a finished frame for a while.
pub(crate) async fn catch_up(write: &mut Write, now: Timestamp) -> Result<(), StoreError> {
    let behind: Vec<uuid::Uuid> = sqlx::query_scalar(
        "SELECT job_id FROM live_forecasts INDEXED BY live_forecasts_behind WHERE frames_since > 0 AND updated_at <= ? ORDER BY updated_at, job_id",
    )
    .bind(now.plus_micros(-BETWEEN_PIXELS).micros())
    .fetch_all(write.connection().await?)
    .await?;
    for job in behind {
        update(write, JobId(job), Occasion::Meanwhile, now).await?;
    }
    Ok(())
}

fn figure(quote: &Quantiles, frames: &[LiveFrame], measure: Measure) -> LiveFigure {
    let &Quantiles { mean, p50, p80, p95 } = quote;
    let found = live(&Band { mean, p50, p80, p95 }, frames, measure);
    let quantiles = |Band { mean, p50, p80, p95 }| Quantiles { mean, p50, p80, p95 };
    LiveFigure {
        quote: *quote,
        spent: found.spent,
        remaining: quantiles(found.remaining),
        whole: quantiles(found.whole),
        factor: found.factor,
    }
}

/// CPU seconds that the cache that the frames share is yet to take, on a node of speed 1: as quoted, less what is done of it.
async fn shared_cache_left(
    connection: &mut SqliteConnection,
    job: JobId,
    quote: &JobForecast,
) -> Result<Quantiles, StoreError> {
    let quoted = quote.shared_cache_seconds();
    Ok(match seeds::progress(connection, job).await? {
        None => quoted,
        Some(SeedProgress { ready: true, .. }) => Quantiles::default(),
        Some(SeedProgress { cpu_seconds, .. }) => quoted.less(cpu_seconds),
    })
}

/// Micro-units for a CPU second in the quote.
fn price(quote: &JobForecast) -> Option<f64> {
    let seconds = quote.total.cpu_seconds.mean + quote.shared_cache_seconds().mean;
    Some(quote.cost?.mean.micro_units() as f64 / seconds).filter(|price| price.is_finite())
}

/// The bookings, as long as is now expected.
fn stretched(bookings: &[OpenBooking], by: f64) -> Vec<OpenBooking> {
    let mut bookings = bookings.to_vec();
    for OpenBooking { booking, .. } in &mut bookings {
        let length = booking.end.micros_since(booking.start) as f64 * by;
        booking.end = booking.start.plus_micros((length as i64).max(1));
    }
    bookings
}

/// By how many microseconds a job must end later than booked for that to count.
async fn delay_that_counts(
    connection: &mut SqliteConnection,
    plan: PlanId,
    job: JobId,
    finish: Option<Timestamp>,
) -> Result<i64, StoreError> {
    let begin: Option<i64> =
        sqlx::query_scalar("SELECT min(start_at) FROM bookings WHERE plan_id = ? AND job_id = ?")
            .bind(plan.0)
            .bind(job.0)
            .fetch_one(connection)
            .await?;
    let length = match (begin, finish) {
        (Some(begin), Some(finish)) => finish.micros_since(Timestamp::from_micros(begin)),
        _ => 0,
    };
    Ok(((length as f64 * MARGIN) as i64).max(LEAST_DELAY))
}

/// Whether an expectation is off: it leaves by more than the margin, and is back once it is at or below what is booked.
fn is_off(was: bool, expected: f64, booked: f64, margin: f64) -> bool {
    if was { expected > booked } else { expected > booked + margin }
}

/// Says what left the booking, and what came back to it.
async fn tell(
    write: &mut Write,
    job: JobId,
    plan: PlanId,
    live: &LiveForecast,
    was_off: [bool; 2],
) -> Result<(), StoreError> {
    let confidence = live.booked.confidence;
    let expected = live.cpu_seconds.whole.at(confidence);
    let level = confidence.name().to_uppercase();
    let cost =
        live.booked.cost.filter(|_| live.booked.cpu_seconds > 0.0).map(|cost| {
            Money((cost.micro_units() as f64 * (expected / live.booked.cpu_seconds)).round() as i64)
        });
    let is_off = [live.cost_is_off, live.finish_is_off];
    for (quantity, (was, is)) in
        [BookedQuantity::Cost, BookedQuantity::Finish].into_iter().zip(was_off.into_iter().zip(is_off))
    {
        if was == is {
            continue;
        }
        let numbers = match quantity {
            BookedQuantity::Cost => format!(
                "at {level} it takes {expected:.1} CPU seconds in all, {:.1} are booked",
                live.booked.cpu_seconds
            ),
            BookedQuantity::Finish => {
                let time = |at: Option<Timestamp>| at.map_or("-".to_owned(), |at| at.to_string());
                format!(
                    "at {level} it ends at {}, booked until {}",
                    time(live.finish),
                    time(live.booked.finish)
                )
            }
        };
        let what = quantity.name();
        let message = if is {
            format!("the {what} has left what is booked: {numbers}")
        } else {
            format!("the {what} is back within what is booked: {numbers}")
        };
        let kind = if is { EventKind::JobOffForecast } else { EventKind::JobOnForecast };
        let off = OffForecast {
            quantity,
            frames_done: live.frames_done,
            booked: live.booked,
            cpu_seconds: expected,
            cost,
            finish: live.finish,
        };
        append(
            write,
            Event {
                job_id: Some(job),
                plan_id: Some(plan),
                off_forecast: Some(off),
                message: Some(message),
                ..event(kind, live.at)
            },
        )?;
    }
    Ok(())
}
