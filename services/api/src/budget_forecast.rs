//! Forecast of what tonight and the following nights will cost.
//!
//! The open bookings are carried out in many scenarios (`forelight_planner::scenarios`). Frames of a job
//! share the part of their forecast's error that does not average out. Quantiles are taken of the sums, since
//! quantiles of parts do not add up. Random numbers are hashes of scenario, job and frame: the same farm at
//! the same instant gives the same forecast.

mod basis;
mod error;
mod money;
mod periods;
mod planner_input;
mod scenarios;
mod sums;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use forelight_protocol::{
    BudgetChange, BudgetForecast, BudgetForecastRequest, JobId, Money, Night, NightRecord, Timestamp,
};
use forelight_store::{KeptNight, Store, StoreError};

pub use self::error::BudgetForecastError;

use self::basis::Basis;
use self::money::sum;
use self::scenarios::work_out;
use crate::conductor::farm::Snapshot;

/// Most nights in one forecast.
pub const MOST_NIGHTS: u32 = 60;
const REMEMBERED: u32 = 400;
/// Oldest answer that a request may allow, in seconds.
const OLDEST: u32 = 3600;

/// Computes the forecast and keeps it under its first night, replacing an earlier one. After the middle of
/// that night it is not kept: the track record compares the night with what was known before. A forecast of
/// `projects` alone is not kept either, and compared with nothing.
pub async fn budget_forecast(
    store: &Store,
    request: &BudgetForecastRequest,
    projects: Option<Vec<String>>,
    now: Timestamp,
) -> Result<BudgetForecast, BudgetForecastError> {
    let nights = nights(request, now)?;
    let (Some(first), Some(last)) = (nights.first(), nights.last()) else {
        return Err(BudgetForecastError::Invalid {
            pointer: "/days",
            reason: "the forecast covers no night".to_owned(),
        });
    };
    let budgets = store.budgets(now).await?;
    let jobs = store.open_jobs().await?;
    let snapshot = Snapshot::with_all_nodes(store, now).await?;
    let nodes = snapshot.nodes.clone();
    // Budgets of a month, or without an end, began before tonight.
    let begins = budgets.iter().filter_map(|budget| budget.period.bounds(&budget.zone, first.from));
    let since = begins.map(|(from, _)| from).chain([first.from]).min().unwrap_or(first.from);
    let ledger = store.ledger(since, now).await?;
    let zone = request.zone.clone();
    let is_of_all = projects.is_none();
    let basis = Basis { now, zone, nights: nights.clone(), nodes, jobs, ledger, budgets, projects };
    let basis = basis.of_its_projects();
    let mut forecast = tokio::task::spawn_blocking(move || work_out(&basis, &snapshot)).await??;
    name_ended_jobs(store, &mut forecast).await?;
    if is_of_all {
        let past = store.budget_forecasts_before(&request.zone, first.from, REMEMBERED).await?;
        forecast.track_record = track_record(store, &past, now).await?;
        if let Some(before) = past.first() {
            forecast.compared_with = Some(before.forecast.made_at);
            forecast.changes = changes(&before.forecast, &forecast);
        }
        let kept = KeptNight { from: first.from, until: first.until, forecast: forecast.clone() };
        if now < last.until {
            store.keep_budget_forecast(&kept).await?;
        }
    }
    if !request.by_job {
        forecast.nights.iter_mut().for_each(|night| night.jobs.clear());
        forecast.changes.clear();
        forecast.not_ready.clear();
        forecast.unknown.clear();
    }
    Ok(forecast)
}

/// Gives ended jobs their names: the forecast rests on open ones, and knows of others only what they cost.
async fn name_ended_jobs(store: &Store, forecast: &mut BudgetForecast) -> Result<(), StoreError> {
    let mut names: BTreeMap<JobId, String> = BTreeMap::new();
    for line in forecast.nights.iter_mut().flat_map(|night| &mut night.jobs) {
        let Some(id) = line.job_id.filter(|id| line.name == id.to_string()) else { continue };
        if let Entry::Vacant(unknown) = names.entry(id) {
            match store.job(id).await {
                Ok(job) => drop(unknown.insert(job.name)),
                Err(StoreError::NotFound(_)) => continue,
                Err(error) => return Err(error),
            }
        }
        line.name.clone_from(&names[&id]);
    }
    Ok(())
}

fn nights(request: &BudgetForecastRequest, now: Timestamp) -> Result<Vec<Night>, BudgetForecastError> {
    let invalid = |pointer, reason: String| BudgetForecastError::Invalid { pointer, reason };
    if !(1..=MOST_NIGHTS).contains(&request.days) {
        return Err(invalid("/days", format!("1 to {MOST_NIGHTS} nights can be forecast")));
    }
    if request.max_age > OLDEST {
        return Err(invalid("/max_age", format!("an answer is 0 to {OLDEST} seconds old")));
    }
    let tonight = Night::of(&request.zone, now).ok_or_else(|| {
        invalid(
            "/zone",
            format!("there is no time zone {:?}", request.zone.chars().take(100).collect::<String>()),
        )
    })?;
    let beyond = || invalid("/date", "the date is beyond the calendar".to_owned());
    let mut nights = Vec::new();
    let mut date = request.date.unwrap_or(tonight.date);
    for _ in 0..request.days {
        nights.push(Night::on(&request.zone, date).ok_or_else(beyond)?);
        date = date.tomorrow().map_err(|_| beyond())?;
    }
    if nights.last().is_some_and(|last| last.until <= now) {
        return Err(invalid("/date", "these nights are over; choose tonight or later".to_owned()));
    }
    Ok(nights)
}

/// How often forecasts of past nights were right.
async fn track_record(store: &Store, past: &[KeptNight], now: Timestamp) -> Result<NightRecord, StoreError> {
    let mut record = NightRecord::default();
    for night in past.iter().filter(|night| night.until <= now && night.forecast.beforehand) {
        let Some(said) = night.forecast.nights.first() else { continue };
        let lines = store.ledger(night.from, night.until).await?;
        let cost = sum(lines.iter().map(|line| line.cost_within(night.from, night.until)));
        record.nights += 1;
        record.within_p50 += u32::from(cost <= said.cost.p50);
        record.within_p80 += u32::from(cost <= said.cost.p80);
        record.within_p95 += u32::from(cost <= said.cost.p95);
    }
    Ok(record)
}

/// By job, the P80 of all nights in the forecast before and in this one.
fn changes(before: &BudgetForecast, after: &BudgetForecast) -> Vec<BudgetChange> {
    let all = |forecast: &BudgetForecast| {
        let mut jobs: BTreeMap<JobId, (String, i64)> = BTreeMap::new();
        for line in forecast.nights.iter().flat_map(|night| &night.jobs) {
            let Some(job) = line.job_id else { continue };
            let entry = jobs.entry(job).or_insert_with(|| (line.name.clone(), 0));
            entry.1 = entry.1.saturating_add(line.cost.p80.0);
        }
        jobs
    };
    let (before, mut after) = (all(before), all(after));
    let mut changes: Vec<BudgetChange> = Vec::new();
    for (job_id, (name, cost)) in before {
        let now = after.remove(&job_id).map(|(_, cost)| Money(cost));
        if now != Some(Money(cost)) {
            changes.push(BudgetChange { job_id, name, before: Some(Money(cost)), after: now });
        }
    }
    let new = after.into_iter();
    changes.extend(new.map(|(job_id, (name, cost))| BudgetChange {
        job_id,
        name,
        before: None,
        after: Some(Money(cost)),
    }));
    changes
}

#[cfg(test)]
mod tests;
