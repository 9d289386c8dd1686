//! The truth about a farm, known or not.

use forelight_planner::chance::{normal, uniform};
use forelight_planner::{Division, Input, InputError, Interval, Task, free_time, least_cost};
use serde::{Deserialize, Serialize};

/// Purposes of random numbers: the first index of each.
const COMMON: u64 = 1;
const OWN: u64 = 2;
const FAILURE: u64 = 3;
const REPAIR: u64 = 4;
const WITHDRAWN: u64 = 5;

const HOUR: f64 = 3.6e9;

/// Random events of a world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Chances {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Ratio of true work to forecasts, for all jobs.
    pub bias: f64,
    /// Ratio of true to forecast spread, for jobs and frames.
    pub spread: f64,
    /// Mean hours from a node's repair to its next failure. 0: no failures.
    pub hours_between_failures: f64,
    /// Mean hours of a repair.
    pub hours_of_repair: f64,
    /// Seconds from a worker's last renewal until its lease expires.
    pub lease_seconds: f64,
    /// Work of a frame's own cache, as a share of the job's shared one. 0: frames need the shared one.
    pub own_cache: f64,
    /// Share of jobs that are withdrawn before their deadline.
    pub withdrawn: f64,
}

impl Default for Chances {
    fn default() -> Self {
        Chances {
            seed: 1,
            bias: 1.0,
            spread: 1.0,
            hours_between_failures: 30.0 * 24.0,
            hours_of_repair: 4.0,
            lease_seconds: 60.0,
            own_cache: 0.0,
            withdrawn: 0.01,
        }
    }
}

/// A farm, its jobs, and the truth about both.
#[derive(Clone, Debug)]
pub struct World {
    /// Nodes and jobs by id, as everyone knows them. A job comes in at its release.
    pub(crate) input: Input,
    pub(crate) chances: Chances,
    /// When each node may be used.
    pub(crate) windows: Vec<Vec<Interval>>,
    /// For each job, its tasks: those of the shared cache first, then frames in the given order.
    pub(crate) tasks: Vec<Vec<TrueTask>>,
    /// For each job, when it is withdrawn.
    pub(crate) withdrawn: Vec<Option<i64>>,
    /// End of the simulation.
    pub(crate) horizon: i64,
}

/// A task and its true work.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrueTask {
    pub task: Task,
    /// Forecast median.
    pub median: u64,
    /// True work.
    pub work: u64,
    pub class: u32,
    /// How a frame may be divided. Everything else is whole.
    pub division: Division,
}

/// Time after the last deadline, so that late jobs can finish.
const PATIENCE: i64 = 60 * 24 * 3_600_000_000;

impl World {
    /// Draws the truth. The order of nodes and jobs does not matter. Movable bookings are ignored.
    ///
    /// # Errors
    /// If the input is invalid.
    pub fn new(mut input: Input, chances: Chances) -> Result<Self, InputError> {
        input.check()?;
        input.movable.clear();
        input.nodes.sort_by_key(|node| node.id);
        input.jobs.sort_by_key(|job| job.id);
        for job in &mut input.jobs {
            job.release = job.release.max(input.now);
        }
        let seed = chances.seed;
        let windows = input.nodes.iter().map(|node| free_time(node, input.now, &input.fixed)).collect();
        let mut tasks = Vec::with_capacity(input.jobs.len());
        let mut withdrawn = Vec::with_capacity(input.jobs.len());
        let mut last = input.now;
        for job in &input.jobs {
            let z = normal(seed, &[COMMON, job.id]);
            let common = libm::pow(job.common_factor(z), chances.spread) * chances.bias;
            let drawn = |median: u64, own: f64| -> u64 {
                // Casts of floats saturate.
                (median as f64 * common * own).round().max(1.0) as u64
            };
            let done: std::collections::BTreeSet<i64> = job.done.iter().copied().collect();
            let mut of_job: Vec<TrueTask> = Vec::with_capacity(job.frames.len() + 1);
            if let Some(cache) = job.shared_cache {
                let median = cache.work.div_ceil(u64::from(cache.parts.max(1)));
                let work = drawn(median, 1.0);
                let class = cache.class;
                let division = Division::Whole;
                of_job.extend(cache.tasks().map(|task| TrueTask { task, median, work, class, division }));
            }
            for frame in job.frames.iter().filter(|frame| !done.contains(&frame.number)) {
                let spread = job.own_spread(frame) * chances.spread;
                let z = normal(seed, &[OWN, job.id, frame.number as u64]);
                of_job.push(TrueTask {
                    task: Task::Frame(frame.number),
                    median: frame.work,
                    work: drawn(frame.work, libm::exp(spread * z - spread * spread / 2.0)),
                    class: job.class,
                    division: frame.division,
                });
            }
            tasks.push(of_job);
            let until = job.deadline.unwrap_or(job.release.saturating_add(PATIENCE / 60)).max(job.release);
            let at = uniform(seed, &[WITHDRAWN, job.id, 1]);
            let offset = (until.saturating_sub(job.release) as f64 * at) as i64;
            let goes = uniform(seed, &[WITHDRAWN, job.id]) < chances.withdrawn;
            withdrawn.push(goes.then(|| job.release.saturating_add(offset).saturating_add(1)));
            last = last.max(until);
        }
        let horizon = last.saturating_add(PATIENCE);
        Ok(World { input, chances, windows, tasks, withdrawn, horizon })
    }

    /// Nodes and jobs by id, as everyone knows them.
    pub fn input(&self) -> &Input {
        &self.input
    }

    /// A job's tasks, with the shared cache, or with frames that each fill their own.
    pub(crate) fn truth(&self, job: usize, shared: bool) -> Vec<TrueTask> {
        let tasks = self.tasks[job].iter().copied();
        if shared {
            return tasks.collect();
        }
        let (cache_parts, frames): (Vec<TrueTask>, Vec<TrueTask>) =
            tasks.partition(|task| task.task.is_shared_cache());
        let own = |of: fn(&TrueTask) -> u64| {
            let all = cache_parts.iter().fold(0u64, |sum, part| sum.saturating_add(of(part)));
            (all as f64 * self.chances.own_cache).round() as u64
        };
        let (median, work) = (own(|task| task.median), own(|task| task.work));
        let with_own = |task: TrueTask| TrueTask {
            median: task.median.saturating_add(median),
            work: task.work.saturating_add(work),
            ..task
        };
        frames.into_iter().map(with_own).collect()
    }

    /// Lower bound of any policy's cost that keeps all deadlines that can be kept, in micro-units. The bound
    /// knows the true work and all jobs from the start, and has no failures. Withdrawn jobs do not count.
    ///
    /// # Errors
    /// If the input is invalid.
    pub fn least_cost(&self) -> Result<i64, InputError> {
        let mut known = self.input.clone();
        let mut index = 0;
        known.jobs.retain_mut(|job| {
            let (tasks, withdrawn) = (&self.tasks[index], self.withdrawn[index]);
            index += 1;
            let mut frames = Vec::with_capacity(tasks.len());
            let mut before = 0u64;
            for task in tasks {
                match task.task.frame() {
                    None => before = before.saturating_add(task.work),
                    Some(number) => frames.push(forelight_planner::Frame {
                        number,
                        work: task.work,
                        division: task.division,
                        ..forelight_planner::Frame::default()
                    }),
                }
            }
            if self.chances.own_cache > 0.0 {
                // Own caches cost at least this much more on the same nodes, if they are the same.
                let all = (before as f64 * self.chances.own_cache).round() as u64;
                let same = job.shared_cache.is_some_and(|cache| cache.class == job.class);
                let least = before.min(all.saturating_mul(frames.len() as u64));
                before = if same { least } else { 0 };
            }
            job.shared_cache =
                job.shared_cache.map(|cache| forelight_planner::SharedCache { work: before, ..cache });
            let total = frames.iter().fold(0u64, |sum, frame| sum.saturating_add(frame.work));
            job.total = forelight_planner::WorkTotal { p50: total, p80: total, p95: total };
            job.frames = frames;
            job.done.clear();
            withdrawn.is_none()
        });
        least_cost(&known)
    }

    /// Microseconds from a node's n-th repair (0: the start) to its next failure. `None` without failures.
    pub(crate) fn until_failure(&self, node: usize, n: u64) -> Option<i64> {
        let mean = self.chances.hours_between_failures;
        (mean > 0.0).then(|| self.exponential(FAILURE, node, n, mean))
    }

    /// Duration of its n-th repair in microseconds.
    pub(crate) fn repair(&self, node: usize, n: u64) -> i64 {
        self.exponential(REPAIR, node, n, self.chances.hours_of_repair)
    }

    pub(crate) fn lease(&self) -> i64 {
        ((self.chances.lease_seconds * 1e6) as i64).max(1)
    }

    fn exponential(&self, what: u64, node: usize, n: u64, mean_hours: f64) -> i64 {
        let u = uniform(self.chances.seed, &[what, self.input.nodes[node].id, n]);
        ((-libm::log(u) * mean_hours * HOUR) as i64).max(1)
    }
}
