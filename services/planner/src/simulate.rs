//! The risk of a plan, by Monte Carlo: the plan runs many times, with work drawn from the forecast's
//! distribution.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::calendar::Window;
use crate::chance::normal;
use crate::model::{Frame, Input, InputError, JobPlan, Plan, Task, Verdict, price_of};
use crate::problem::Problem;

/// The result of all scenarios.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Simulation {
    /// The number of scenarios.
    pub scenarios: u32,
    /// By job.
    pub jobs: Vec<JobRisk>,
    /// Cost in micro-units at P50, P80 and P95.
    pub cost: [i64; 3],
    /// Last end of all jobs that find a place, at P50, P80 and P95. `None` if there is none.
    #[serde(skip)]
    pub finish: [Option<i64>; 3],
}

/// The risk of one job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobRisk {
    /// The job.
    pub job: u64,
    /// The number of scenarios in which it missed its deadline.
    pub late: u32,
    /// End of its last frame at P50, P80 and P95. `None` if the job then finds no more free time.
    pub finish: [Option<i64>; 3],
}

impl JobRisk {
    /// The probability of being late, from 0 to 1.
    pub fn probability(&self, scenarios: u32) -> f64 {
        if scenarios == 0 { 0.0 } else { f64::from(self.late) / f64::from(scenarios) }
    }
}

/// Runs the plan in this many scenarios. The same seed gives the same result.
///
/// The work of a frame is its forecast median, times a factor that all frames of the job share, times a
/// factor of its own. The shared factor has the quantiles of the job's total.
///
/// Every node keeps the plan's order. A task starts in the first free stretch that is long enough, once the
/// node is idle, the job released and its shared cache done. Costs vary with rented time. Set-ups and
/// rounding to billing steps cost what they cost in the plan.
///
/// # Errors
/// If the input is invalid.
pub fn simulate(input: &Input, plan: &Plan, scenarios: u32, seed: u64) -> Result<Simulation, InputError> {
    input.check()?;
    let problem = Problem::new(input);
    let tasks = tasks(&problem, plan);
    let planned = tasks.iter().fold(0i64, |sum, task| sum.saturating_add(task.price(task.bought)));
    let fixed_part = plan.cost.saturating_sub(planned);
    let mut finishes: Vec<Vec<i64>> = vec![Vec::with_capacity(scenarios as usize); problem.jobs.len()];
    let mut costs = Vec::with_capacity(scenarios as usize);
    let mut last_ends = Vec::with_capacity(scenarios as usize);
    let booked: BTreeSet<u64> = plan.bookings.iter().map(|booking| booking.job).collect();
    for scenario in 0..scenarios {
        let (ends, cost) = carry_out(&problem, &tasks, seed, u64::from(scenario), |_, _, _| {});
        let placed = problem.jobs.iter().zip(&ends).filter(|(work, _)| booked.contains(&work.job.id));
        last_ends.extend(placed.map(|(_, &end)| end).filter(|&end| end < i64::MAX).max());
        finishes.iter_mut().zip(ends).for_each(|(all, end)| all.push(end));
        costs.push(cost.saturating_add(fixed_part));
    }
    costs.sort_unstable();
    last_ends.sort_unstable();
    let last = |quantile| (!last_ends.is_empty()).then(|| at(&last_ends, quantile));
    let finish = [last(50), last(80), last(95)];
    let without_place = |job: &&JobPlan| matches!(job.verdict, Verdict::Unplaced { .. });
    let never_done: BTreeSet<u64> = plan.jobs.iter().filter(without_place).map(|job| job.job).collect();
    let jobs = problem.jobs.iter().zip(&mut finishes).map(|(work, ends)| {
        if never_done.contains(&work.job.id) {
            ends.fill(i64::MAX);
        }
        ends.sort_unstable();
        let late =
            ends.iter().filter(|&&end| work.job.deadline.is_some_and(|deadline| end > deadline)).count();
        let finite = |quantile| Some(at(ends, quantile)).filter(|&end| end < i64::MAX);
        JobRisk { job: work.job.id, late: late as u32, finish: [finite(50), finite(80), finite(95)] }
    });
    let cost = [at(&costs, 50), at(&costs, 80), at(&costs, 95)];
    Ok(Simulation { scenarios, jobs: jobs.collect(), cost, finish })
}

/// Time of a node that a job uses in a scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stretch {
    /// The job.
    pub job: u64,
    /// The node.
    pub node: u64,
    /// First instant.
    pub start: i64,
    /// The instant after the last. `i64::MAX` if no free stretch is long enough.
    pub end: i64,
}

/// Runs the plan as [`simulate`] does. Calls `visit` for each scenario with its number and the stretches, in
/// the order of the plan's bookings.
///
/// # Errors
/// If the input is invalid.
pub fn scenarios(
    input: &Input,
    plan: &Plan,
    scenarios: u32,
    seed: u64,
    mut visit: impl FnMut(u32, &[Stretch]),
) -> Result<(), InputError> {
    input.check()?;
    let problem = Problem::new(input);
    let tasks = tasks(&problem, plan);
    let mut stretches = Vec::with_capacity(tasks.len());
    for scenario in 0..scenarios {
        stretches.clear();
        carry_out(&problem, &tasks, seed, u64::from(scenario), |task, start, end| {
            let (job, node) = (problem.jobs[task.job].job.id, problem.nodes[task.node].id);
            stretches.push(Stretch { job, node, start, end });
        });
        visit(scenario, &stretches);
    }
    Ok(())
}

/// The quantile of sorted values. Zero if there are none.
fn at(sorted: &[i64], per_cent: usize) -> i64 {
    let rank = (sorted.len() * per_cent).div_ceil(100);
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0)
}

/// A booking and its distribution.
struct Drawn {
    job: usize,
    node: usize,
    task: Task,
    /// Length at the median of the work.
    median: f64,
    bought: i64,
    /// Standard deviation of the logarithm of the frame's own factor.
    own: f64,
    /// Which factor that is: the frame's number, which its parts share.
    draw: u64,
    price_per_hour: i64,
}

impl Drawn {
    fn price(&self, time: i64) -> i64 {
        price_of(self.price_per_hour, time)
    }
}

fn tasks(problem: &Problem, plan: &Plan) -> Vec<Drawn> {
    let own_spread: Vec<BTreeMap<i64, (f64, i64)>> = problem
        .jobs
        .iter()
        .map(|work| {
            let frames = work.job.frames.iter();
            let one = |frame: &Frame| (work.job.own_spread(frame), frame.part_of.unwrap_or(frame.number));
            frames.map(|frame| (frame.number, one(frame))).collect()
        })
        .collect();
    plan.bookings
        .iter()
        .filter_map(|booking| {
            let (job, node) = problem.job(booking.job).zip(problem.node(booking.node))?;
            let bought = booking.end.saturating_sub(booking.start);
            let total = &problem.jobs[job].job.total;
            let paid = total.at(problem.jobs[job].job.confidence);
            let scale = if paid == 0 { 1.0 } else { total.p50 as f64 / paid as f64 };
            let own = booking.task.frame().and_then(|frame| own_spread[job].get(&frame)).copied();
            Some(Drawn {
                job,
                node,
                task: booking.task,
                median: bought as f64 * scale,
                bought,
                own: own.map_or(0.0, |(spread, _)| spread),
                draw: own.map_or(u64::MAX, |(_, frame)| frame as u64),
                price_per_hour: problem.nodes[node].price_per_hour,
            })
        })
        .collect()
}

/// Runs one scenario. Returns the end of each job, and the cost of the time. `visit` gets each task with its
/// start and end.
fn carry_out(
    problem: &Problem,
    tasks: &[Drawn],
    seed: u64,
    scenario: u64,
    mut visit: impl FnMut(&Drawn, i64, i64),
) -> (Vec<i64>, i64) {
    let factors: Vec<f64> = problem
        .jobs
        .iter()
        .map(|work| work.job.common_factor(normal(seed, &[scenario, work.job.id])))
        .collect();
    let now = problem.input.now;
    let mut free_from = vec![now; problem.nodes.len()];
    let mut ready: Vec<i64> = problem.jobs.iter().map(|work| work.release(now)).collect();
    let mut ends = ready.clone();
    let mut cost = 0i64;
    for task in tasks {
        let work = &problem.jobs[task.job];
        let own = if task.own > 0.0 {
            let z = normal(seed, &[scenario, work.job.id, task.draw]);
            // The mean is one, so that the frames' own factors do not change the total.
            libm::exp(task.own * z - task.own * task.own / 2.0)
        } else {
            1.0
        };
        // Saturates beyond the range of time.
        let length = ((task.median * factors[task.job] * own).ceil() as i64).max(1);
        let end = first_end(problem, task, free_from[task.node].max(ready[task.job]), length);
        visit(task, if end < i64::MAX { end - length } else { end }, end);
        free_from[task.node] = end;
        if task.task.is_shared_cache() {
            ready[task.job] = ready[task.job].max(end);
        }
        ends[task.job] = ends[task.job].max(end);
        cost = cost.saturating_add(task.price(length));
    }
    (ends, cost)
}

/// The earliest end of a task that starts at `from` or later. `i64::MAX` if it fits nowhere.
fn first_end(problem: &Problem, task: &Drawn, from: i64, length: i64) -> i64 {
    let node = problem.nodes[task.node];
    let windows = &problem.windows[task.node];
    let first = windows.partition_point(|window| window.end <= from);
    let fits = |window: &Window| {
        let ready = if window.warm { window.start } else { window.start.saturating_add(node.setup) };
        ready.max(from).checked_add(length).filter(|&end| end <= window.end)
    };
    windows[first..].iter().find_map(fits).unwrap_or(i64::MAX)
}
