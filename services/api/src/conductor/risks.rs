//! What happens to jobs in the scenarios of a plan. Pure.

use forelight_planner as planner;
use forelight_store::FinishSpread;

use super::AdvanceError;
use super::farm::Farm;
use super::settle::end;

const SCENARIOS: usize = 400;
const MOST_DRAWS: usize = 1_000_000;
/// Seed of the random numbers. It is constant, so probabilities differ only if the farm does.
const SEED: u64 = 0x0070_726f_6d69_7365;

/// What happens to a job in the scenarios.
#[derive(Clone, Copy, Debug)]
pub(super) struct Risk {
    /// Probability that it meets its deadline. `None` without one.
    pub probability: Option<f64>,
    pub finish: Option<FinishSpread>,
}

impl Risk {
    /// The risk of a job, which misses its deadline for certain if it lacks money.
    pub fn given_money(self, lacks_money: bool) -> Self {
        Self { probability: self.probability.map(|found| if lacks_money { 0.0 } else { found }), ..self }
    }
}

/// The most scenarios that a plan of this size is worth.
fn scenarios(plan: &planner::Plan) -> u32 {
    (MOST_DRAWS / plan.bookings.len().max(1)).clamp(50, SCENARIOS) as u32
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
    let simulation = planner::simulate(&farm.input, plan, scenarios(plan), SEED)?;
    let last = plan.bookings.iter().map(|booking| booking.end).max();
    let jobs = (0..farm.jobs.len()).map(|job| of_job(farm, plan, &simulation, job)).collect();
    Ok((jobs, spread(simulation.finish, last)))
}

/// What happens to a job in the scenarios of a plan for it alone, around the bookings of others.
pub(super) fn risk(
    farm: &Farm,
    around: &planner::Input,
    plan: &planner::Plan,
    job: usize,
) -> Result<Risk, AdvanceError> {
    Ok(of_job(farm, plan, &planner::simulate(around, plan, scenarios(plan), SEED)?, job))
}

fn of_job(farm: &Farm, plan: &planner::Plan, simulation: &planner::Simulation, job: usize) -> Risk {
    let asked = &farm.jobs[job];
    let risk = simulation.jobs.iter().find(|risk| risk.job == job as u64);
    let late = risk.map_or(0.0, |risk| risk.probability(simulation.scenarios));
    let planned = plan.job(job as u64).and_then(|entry| entry.verdict.finish());
    Risk {
        probability: asked.job.deadline.map(|_| match end(farm, plan, job) {
            // A job that is held has no end until it is let go.
            None => 0.0,
            Some(_) if asked.held => 0.0,
            // Scenarios vary frames that wait. Those under way have a course of their own.
            Some(_) => asked.under_way_in_time * (1.0 - late),
        }),
        finish: risk.and_then(|risk| spread(risk.finish, planned)),
    }
}
