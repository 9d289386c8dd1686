//! Runs simulations and collects their reports.

use anyhow::Result;
use forelight_simulator::{Chances, PolicyKind, Report, World, report, run as simulate};
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use serde::Serialize;

#[derive(Debug, Serialize)]
pub(super) struct Document {
    pub worlds: Vec<Simulated>,
    /// For a fixed case: the results to check.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub findings: Vec<Finding>,
}

#[derive(Debug, Serialize)]
pub(super) struct Simulated {
    pub name: String,
    pub nodes: usize,
    pub jobs: usize,
    pub chances: Chances,
    pub reports: Vec<Report>,
}

#[derive(Debug, Serialize)]
pub(super) struct Finding {
    pub what: String,
    pub found: f64,
    pub wanted: f64,
    /// Whether `wanted` is the most. Otherwise it is the least.
    pub at_most: bool,
    pub reached: bool,
}

pub(super) struct Runner<'a> {
    pub every: i64,
    pub chances: Chances,
    pub bars: Bars,
    pub interrupt: &'a Interrupt,
}

impl Runner<'_> {
    /// Simulates a world under each policy, with a pool of so many per cent of its nodes.
    pub fn world(&self, name: String, world: &World, runs: &[(PolicyKind, u32)]) -> Result<Simulated> {
        let spinner = self.bars.spinner("lower bound of the cost");
        let bound = world.least_cost()?;
        spinner.finish_and_clear();
        let mut reports = Vec::new();
        for &(kind, pool) in runs {
            let bar = self.bars.bar(kind.name(), world.input().jobs.len() as u64);
            let mut policy = kind.policy(world, self.every, pool);
            // An interrupted simulation has no result; the thread ends with the process.
            let mut stopped = false;
            let record = simulate(world, policy.as_mut(), |over, _| {
                stopped |= self.interrupt.is_set();
                bar.set_position(over);
            });
            bar.finish_and_clear();
            if stopped {
                return Err(Interrupted.into());
            }
            reports.push(report(world, kind, pool, policy.plans(), bound, &record));
        }
        let input = world.input();
        let (nodes, jobs) = (input.nodes.len(), input.jobs.len());
        Ok(Simulated { name, nodes, jobs, chances: self.chances, reports })
    }
}
