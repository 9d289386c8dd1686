//! Forecasts beside what was measured, frame by frame.

use super::images::is_deleted;
use crate::caches;
use crate::storage::stored;
use forelight_protocol::words::counted;
use forelight_protocol::{
    AllottedStats, AnswersDoc, CacheQuote, ForecastDoc, FrameRow, FrameState, Job, JobState, LeftOut,
    Timestamp, Verdict,
};
use forelight_terminal::output;
use forelight_terminal::quantities::{clock, count, money, percent, seconds, with_local_times};
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use std::fmt::Display;

#[derive(Debug, Serialize)]
pub struct Document<'a> {
    pub job: &'a Job,
    pub forecast: Option<&'a ForecastDoc>,
    pub frames: &'a [FrameRow],
}

pub fn report(job: &Job, forecast: Option<&ForecastDoc>, frames: &[FrameRow], now: Timestamp) -> String {
    let head = [
        ("frame", Align::Right),
        ("forecast", Align::Right),
        ("actual", Align::Right),
        ("error", Align::Right),
        ("CPU forecast", Align::Right),
        ("actual", Align::Right),
        ("error", Align::Right),
        ("booked", Align::Left),
        ("on", Align::Left),
        ("started", Align::Right),
        ("finished", Align::Right),
        ("remarks", Align::Left),
    ];
    let mut table = Table::new(&head);
    let time = |at: Option<Timestamp>| at.map_or("-".into(), |at| clock(at, now));
    for row in frames {
        let (work, cpu) = (row.work, row.cpu_seconds);
        let booked = row.booked.as_ref();
        table.row([
            row.frame.to_string(),
            work.map_or("-".into(), |work| count(work.forecast.mean)),
            work.and_then(|work| work.actual).map_or("-".into(), count),
            work.and_then(|work| work.error).map_or("-".into(), percent),
            cpu.map_or("-".into(), |cpu| seconds(cpu.forecast.mean)),
            cpu.and_then(|cpu| cpu.actual).map_or("-".into(), seconds),
            cpu.and_then(|cpu| cpu.error).map_or("-".into(), percent),
            booked.map_or("-".into(), |b| format!("{} - {}", clock(b.start, now), clock(b.end, now))),
            booked.map_or_else(String::new, |b| b.node.clone()),
            time(row.started),
            time(row.finished),
            remark(row),
        ]);
    }
    table.footer();
    table.row(totals(frames));
    format!("{}\n{}", table.render(), verdict(job, forecast, frames, now))
}

/// How the irradiance caches are made, both prices, and the shared cache's true cost.
fn made_caches(cache: &CacheQuote, job: &Job) -> String {
    let mut text = caches::ways(cache);
    if let Some(shared) = &cache.shared_cache {
        text += &caches::shared(shared);
        if let Some(done) = job.shared_cache.as_ref().filter(|done| done.ready) {
            text += &format!(
                "; true cost {}, {} operations; forecast {} operations",
                seconds(done.cpu_seconds),
                count(done.work as f64),
                count(shared.work.mean)
            );
        }
        text += "\n";
    }
    text
}

/// Sums over the frames that have both a forecast and a true cost.
fn totals(frames: &[FrameRow]) -> Vec<String> {
    let sums = |figures: &mut dyn Iterator<Item = forelight_protocol::FrameFigure>| {
        let both = figures.filter_map(|figure| Some((figure.forecast.mean, figure.actual?)));
        both.fold((0.0, 0.0), |(forecast, actual), (f, a)| (forecast + f, actual + a))
    };
    let (work, work_actual) = sums(&mut frames.iter().filter_map(|row| row.work));
    let (cpu, cpu_actual) = sums(&mut frames.iter().filter_map(|row| row.cpu_seconds));
    let error =
        |forecast: f64, actual: f64| if actual > 0.0 { percent(forecast / actual - 1.0) } else { "-".into() };
    vec![
        "all".into(),
        count(work),
        count(work_actual),
        error(work, work_actual),
        seconds(cpu),
        seconds(cpu_actual),
        error(cpu, cpu_actual),
    ]
}

fn remark(row: &FrameRow) -> String {
    let mut remarks = Vec::new();
    if row.state != FrameState::Done {
        remarks.push(row.error.clone().unwrap_or_else(|| "not delivered".into()));
    } else if row.attempts > 1 {
        remarks.push(format!("{} attempts", row.attempts));
    }
    if is_deleted(row) {
        remarks.push("its image was deleted".to_owned());
    }
    if let Some(stats) = row.actual.as_ref().filter(|stats| stats.reused_pixels > 0) {
        remarks.push(format!("{} from profiling", counted(stats.reused_pixels, "pixel")));
    }
    if let Some(given) = row.actual.as_ref().and_then(|stats| stats.allotted.as_deref()) {
        let AllottedStats { least, most, mean, error, .. } = given;
        remarks.push(format!(
            "{least} to {most} samples a pixel, {mean:.1} on average; noise {:.2} % of the mean",
            100.0 * error.p50
        ));
    }
    if let Some(denoised) = row.actual.as_ref().and_then(|stats| stats.denoised.as_ref()) {
        let [error, noisy] = [denoised.error, denoised.noisy].map(|error| 100.0 * error.p50);
        remarks.push(format!("denoised: error {error:.2} % of the mean in place of {noisy:.2} %"));
    }
    let cache = row.actual.as_ref().and_then(|stats| stats.cache);
    if let Some(cache) = cache.filter(|cache| cache.reused_records > 0) {
        remarks.push(format!("{} from profiling", counted(cache.reused_records, "cache record")));
    }
    if let Some(cache) = cache.filter(|cache| cache.shared_records > 0 || cache.dropped_records > 0) {
        remarks.push(format!(
            "{} cache records shared, {} dropped, {} of its own",
            cache.shared_records, cache.dropped_records, cache.own_records
        ));
    }
    remarks.join("; ")
}

/// The quote of a job that waits to be accepted, and what a plan would make of it now.
pub fn quoted(job: &Job, forecast: &ForecastDoc, answers: &AnswersDoc, now: Timestamp) -> String {
    let mut text = quote(job, forecast);
    for line in &answers.outlook {
        let confidence = line.confidence.name().to_uppercase();
        let ready = line.finish.map_or("never ready".to_owned(), |at| format!("ready by {}", clock(at, now)));
        let in_time = match line.in_time {
            Some(true) => ", in time",
            Some(false) => ", too late",
            None => "",
        };
        text += &format!("at {confidence}     {ready}{in_time}, for {}\n", money(line.cost.micro_units()));
    }
    let hold = job.budget_hold.as_ref().map(|hold| &hold.because);
    for reason in answers.why_not.iter().chain(hold) {
        text += &format!("           {reason}\n");
    }
    for way in &answers.ways_out {
        text += &format!("           {}\n", way.words);
    }
    with_local_times(&text, now)
        + &format!(
            "nothing is booked; `forelight accept {0}` books it, `forelight cancel {0}` drops it\n",
            job.id
        )
}

/// So many of all frames, in words.
pub fn delivered(done: impl Display, all: u32) -> String {
    format!("{done} of {}", counted(all, "frame"))
}

/// What became of a job, after its name.
pub fn ended(state: JobState) -> String {
    match state {
        JobState::Failed => "failed".to_owned(),
        JobState::Cancelled => "was cancelled".to_owned(),
        other => format!("is {other}"),
    }
}

/// The quote of a job: CPU time, price, storage, caches.
pub fn quote(job: &Job, quote: &ForecastDoc) -> String {
    let mut text = String::new();
    let shared = quote.cache.as_ref().map(CacheQuote::shared_cache_seconds).unwrap_or_default();
    let cpu = quote.total.cpu_seconds.plus(&shared);
    text += &format!(
        "quoted     {} CPU time (P50), {} (P80), {} (P95){}",
        seconds(cpu.p50),
        seconds(cpu.p80),
        seconds(cpu.p95),
        if shared.mean > 0.0 { ", frames and shared cache" } else { "" }
    );
    if let Some(cost) = &quote.cost {
        text += &format!("; costs {} (P50), {} (P80)", money(cost.p50.0), money(cost.p80.0));
    }
    text += "\n";
    if let Some(storage) = &quote.storage {
        text += &stored(storage);
    }
    if let Some(cache) = &quote.cache {
        text += &made_caches(cache, job);
    }
    if !quote.effects.is_empty() {
        text += &format!("simulated  {}\n", output::list(&quote.effects));
    }
    for LeftOut { what, reason } in &quote.left_out {
        text += &format!("left out   {what}: {reason}\n");
    }
    text
}

fn verdict(job: &Job, forecast: Option<&ForecastDoc>, frames: &[FrameRow], now: Timestamp) -> String {
    let mut text = forecast.map(|forecast| quote(job, forecast)).unwrap_or_default();
    if let Some(verdict) = &job.verdict {
        let said = match verdict.verdict {
            Verdict::OnTime => "on time",
            Verdict::Late => "late",
            Verdict::OverBudget => "over budget",
            Verdict::Impossible => "impossible",
        };
        let confidence = verdict.confidence.name().to_uppercase();
        text += &format!("planned    {said} at {confidence}");
        if let Some(finish) = verdict.finish {
            text += &format!(", ready by {}", clock(finish, now));
        }
        if let Some(cost) = verdict.cost {
            text += &format!(", for {}", money(cost.0));
        }
        text += "\n";
        let hold = job.budget_hold.as_ref().map(|hold| &hold.because);
        for reason in verdict.reasons.iter().chain(hold) {
            text += &format!("           {reason}\n");
        }
    }
    let done = frames.iter().filter(|row| row.state == FrameState::Done).count();
    text += &format!("delivered  {}", delivered(done, job.frames_total));
    if let Some(finished) = job.finished_at.filter(|_| job.state == JobState::Done) {
        text += &format!(" by {}", clock(finished, now));
        if let Some(deadline) = job.deadline {
            let late = finished.micros_since(deadline);
            let word = if late > 0 { "late" } else { "before the deadline" };
            text += &format!(", {} {word}", seconds(late.unsigned_abs() as f64 * 1e-6));
        }
    } else if job.state != JobState::Done {
        text += &format!("; the job {}", ended(job.state));
    }
    text + "\n"
}
