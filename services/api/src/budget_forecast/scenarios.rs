//! Carries out the bookings in many scenarios and adds up their cost.

use std::collections::BTreeSet;

use forelight_planner as planner;
use forelight_protocol::{
    BudgetForecast, BudgetOutlook, JobId, JobState, Night, NightRecord, NotReady, Timestamp,
};
use forelight_store::OpenJob;

use super::basis::Basis;
use super::error::BudgetForecastError;
use super::money::{Paid, add, at, quantiles};
use super::periods::{THREATENED, outlook, periods};
use super::planner_input::planner_input;
use super::sums::Sums;
use crate::conductor::farm::Snapshot;
use crate::conductor::numbers::frame_part;

const SCENARIOS: usize = 2000;
const MOST_DRAWS: usize = 4_000_000;

/// Seed of the random numbers. It is constant, so forecasts differ only if the farm does.
const SEED: u64 = 0x6e69_6768_7473;

pub(super) fn work_out(basis: &Basis, snapshot: &Snapshot) -> Result<BudgetForecast, BudgetForecastError> {
    let jobs: Vec<JobId> = basis.jobs.iter().map(|open| open.job.id).collect();
    let (input, plan) = planner_input(snapshot, &jobs);
    let booked: BTreeSet<(u64, u32)> = plan
        .bookings
        .iter()
        .filter_map(|booking| Some((booking.job, frame_part(booking.task)?.frame)))
        .collect();
    let scenarios = (MOST_DRAWS / plan.bookings.len().max(1)).clamp(200, SCENARIOS);
    let mut sums = Sums::new(basis, scenarios);
    let mut periods = periods(basis, scenarios);
    let mut ends: Vec<Vec<i64>> = vec![vec![i64::MIN; scenarios]; basis.jobs.len()];
    let count = u32::try_from(scenarios).unwrap_or(u32::MAX);
    planner::scenarios(&input, &plan, count, SEED, |scenario, stretches| {
        let scenario = scenario as usize;
        for stretch in stretches {
            let (job, node) = (stretch.job as usize, stretch.node as usize);
            ends[job][scenario] = ends[job][scenario].max(stretch.end);
            if !basis.is_about(&basis.jobs[job].job.project) {
                continue;
            }
            let paid = Paid {
                price: basis.nodes[node].price_per_hour,
                from: Timestamp::from_micros(stretch.start),
                until: Timestamp::from_micros(stretch.end),
            };
            let [project, own] = sums.of_jobs[job];
            for (index, night) in basis.nights.iter().enumerate() {
                let cost = paid.within(night.from, night.until);
                if cost > 0 {
                    for group in [0, project, own, sums.of_nodes[node]] {
                        add(&mut sums.to_come[index][group], scenarios, scenario, cost);
                    }
                    sums.all[scenario] = sums.all[scenario].saturating_add(cost);
                }
            }
            for period in
                periods.iter_mut().filter(|period| period.budget.project == basis.jobs[job].job.project)
            {
                let cost = paid.within(period.from, basis.horizon(period.until));
                add(&mut period.to_come, scenarios, scenario, cost);
            }
        }
    })?;
    sums.to_come.iter_mut().flatten().for_each(|draws| draws.sort_unstable());
    sums.all.sort_unstable();
    ends.iter_mut().for_each(|ends| ends.sort_unstable());
    let spent = sums.spent.iter().fold(0i64, |sum, night| sum.saturating_add(night[0]));
    let unknown: Vec<String> = basis
        .jobs
        .iter()
        .filter(|open| open.forecast.is_none() && basis.is_about(&open.job.project))
        .map(|job| job.job.name.clone())
        .collect();
    let budgets: Vec<BudgetOutlook> = periods.into_iter().map(outlook).collect();
    let middle = |night: &Night| night.from.plus_micros(night.until.micros_since(night.from) / 2);
    Ok(BudgetForecast {
        date: basis.nights[0].date,
        days: u32::try_from(basis.nights.len()).unwrap_or(u32::MAX),
        zone: basis.zone.clone(),
        made_at: basis.now,
        beforehand: basis.now < middle(&basis.nights[0]),
        scenarios: count,
        nights: (0..basis.nights.len()).map(|index| sums.night(basis, index)).collect(),
        cost: quantiles(&sums.all, spent),
        threatened: budgets.iter().any(|budget| budget.threatened),
        budgets,
        not_ready: basis
            .jobs
            .iter()
            .zip(&ends)
            .zip(0..)
            .filter(|((open, _), _)| basis.is_about(&open.job.project))
            .filter_map(|((open, ends), job)| {
                let is_booked = open.frames.iter().all(|&(frame, ..)| booked.contains(&(job, frame)));
                not_ready(basis, open, ends, is_booked)
            })
            .collect(),
        unknown_total: u32::try_from(unknown.len()).unwrap_or(u32::MAX),
        unknown,
        compared_with: None,
        changes: Vec::new(),
        track_record: NightRecord::default(),
    })
}

/// `is_booked`: whether all of its frames are.
fn not_ready(basis: &Basis, open: &OpenJob, ends: &[i64], is_booked: bool) -> Option<NotReady> {
    let job = &open.job;
    let horizon = basis.nights.last()?.until;
    let deadline = job.deadline.filter(|&deadline| deadline <= horizon)?;
    let known = open.forecast.is_some();
    let late = ends.iter().filter(|&&end| end > deadline.micros()).count();
    let never = open.held || !is_booked || job.deadline.is_some_and(|deadline| deadline <= basis.now);
    let probability = if never { 1.0 } else { late as f64 / ends.len().max(1) as f64 };
    if known && probability <= THREATENED {
        return None;
    }
    let finish = |per_cent| {
        let end = at(ends, per_cent).filter(|_| known && is_booked && !open.held)?;
        (end > i64::MIN && end < i64::MAX).then(|| Timestamp::from_micros(end))
    };
    let reason = if !known {
        "it is not forecast yet"
    } else if job.paused {
        "it is paused"
    } else if open.held {
        "its project's budget is used up"
    } else if deadline <= basis.now {
        "its deadline has passed"
    } else if job.state == JobState::Quoted {
        "it waits to be accepted"
    } else if !is_booked {
        "some of its frames are booked nowhere"
    } else {
        "what is booked takes longer"
    };
    Some(NotReady {
        job_id: job.id,
        name: job.name.clone(),
        project: job.project.clone(),
        deadline,
        probability: known.then_some(probability),
        finish: [finish(50), finish(80), finish(95)],
        reason: reason.to_owned(),
    })
}
