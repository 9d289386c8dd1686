//! What happens to jobs in the scenarios of a plan. Pure.

use forelight_planner as planner;
use forelight_store::FinishSpread;

use super::AdvanceError;
use super::farm::{Asked, Farm};

const SCENARIOS: usize = 400;
const MOST_DRAWS: usize = 1_000_000;
/// Seed of the random numbers. It is constant, so probabilities differ only if the farm does.
const SEED: u64 = 0x0070_726f_6d69_7365;

/// What happens to a job in the scenarios.
#[derive(Clone, Copy, Debug)]
pub(super) struct Risk {
    /// Share of scenarios in which it meets its deadline.
    pub in_time: f64,
    pub finish: Option<FinishSpread>,
}

/// The quantiles of an end, less the planned end. `None` if some scenario has no end.
fn spread(quantiles: [Option<i64>; 3], planned: Option<i64>) -> Option<FinishSpread> {
    let planned = planned?;
    let [p50, p80, p95] = quantiles.map(|end| Some(end?.saturating_sub(planned)));
    Some(FinishSpread { p50: p50?, p80: p80?, p95: p95? })
}

/// By job, what happens to it in the scenarios; and how the end of all bookings varies.
pub(super) fn risks(
    farm: &Farm,
    plan: &planner::Plan,
) -> Result<(Vec<Risk>, Option<FinishSpread>), AdvanceError> {
    let count = (MOST_DRAWS / plan.bookings.len().max(1)).clamp(50, SCENARIOS) as u32;
    let simulation = planner::simulate(&farm.input, plan, count, SEED)?;
    let of_job = |(job, asked): (usize, &Asked)| {
        let risk = simulation.jobs.iter().find(|risk| risk.job == job as u64);
        // Scenarios vary frames that wait. Those under way have a course of their own.
        let in_time = asked.under_way_in_time * (1.0 - risk.map_or(0.0, |risk| risk.probability(count)));
        let planned = plan.job(job as u64).and_then(|entry| entry.verdict.finish());
        Risk { in_time, finish: risk.and_then(|risk| spread(risk.finish, planned)) }
    };
    let last = plan.bookings.iter().map(|booking| booking.end).max();
    let jobs = farm.jobs.iter().enumerate().map(of_job).collect();
    Ok((jobs, spread(simulation.finish, last)))
}
