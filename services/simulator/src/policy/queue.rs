//! Today's farm managers: a queue from which any idle node takes the first task. Every job is accepted, nodes
//! are rented on demand, and costs are unknown beforehand.
//!
//! The comparison is generous. The cheapest idle node is taken first, and a rented hour is used to its end.
//! Once a job has finished frames, none is started in a window that is too short for their mean.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use forelight_planner::Task;
use serde::{Deserialize, Serialize};

use crate::farm::{Farm, Policy};
use crate::world::World;

/// Order of jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QueueRule {
    /// The oldest job of the highest priority.
    Fifo,
    /// The project with the fewest running frames for its share, then as [`QueueRule::Fifo`].
    FairShare,
    /// The job with the earliest deadline.
    Deadline,
    /// The job with the earliest deadline. It renders its first, middle and last frame. Their mean then gives
    /// the number of nodes that finish the job one frame before its deadline.
    ThreeFrames,
}

/// A queue.
#[derive(Clone, Debug)]
pub struct Queue {
    rule: QueueRule,
    /// Only nodes below this rank may be used.
    pool: usize,
    /// For each job, whether none of these nodes can do its frames.
    needs_all: Vec<bool>,
}

/// Orders jobs, smallest first.
type Key = (u64, Reverse<i32>, i64, usize);

impl Queue {
    /// A queue that uses this share of the nodes in per cent, cheapest first.
    pub fn new(world: &World, rule: QueueRule, pool_per_cent: u32) -> Self {
        let nodes = &world.input.nodes;
        let pool = (nodes.len() * pool_per_cent as usize).div_ceil(100);
        let mut by_price: Vec<usize> = (0..nodes.len()).collect();
        by_price.sort_by_key(|&node| (crate::farm::price_of_work(&nodes[node]), node));
        let needs_all = |tasks: &Vec<crate::world::TrueTask>| {
            let can = |node: usize| tasks.iter().all(|task| nodes[node].speed_of(task.class) > 0);
            !by_price.iter().take(pool).any(|&node| can(node))
        };
        let needs_all = world.tasks.iter().map(needs_all).collect();
        Queue { rule, pool, needs_all }
    }

    fn key(&self, farm: &Farm, job: usize, running: &BTreeMap<Option<u64>, u64>) -> Key {
        let entry = farm.job(job);
        match self.rule {
            QueueRule::Fifo => (0, Reverse(entry.priority), entry.release, job),
            QueueRule::FairShare => {
                let share = farm.share(entry.project);
                let has = running.get(&entry.project).copied().unwrap_or(0);
                // Shares to a millionth.
                (has.saturating_mul(1_000_000) / share, Reverse(entry.priority), entry.release, job)
            }
            QueueRule::Deadline | QueueRule::ThreeFrames => {
                (0, Reverse(0), entry.deadline.unwrap_or(i64::MAX), job)
            }
        }
    }

    /// Starts one task of the job if a node is available.
    fn start_one(&self, farm: &mut Farm, job: usize) -> bool {
        let Some(task) = self.next_task(farm, job) else { return false };
        let truth = farm.jobs[job].truth[task];
        let class = truth.class;
        let expected = farm.mean_work(job).map(|mean| match truth.task {
            Task::Part { parts, .. } => farm.job(job).part_work(mean, parts),
            _ => mean,
        });
        let mut found = None;
        for node in farm.idle() {
            if farm.rank(node) >= self.pool && !self.needs_all[job] {
                break;
            }
            if farm.can_start(node, job, task).is_err() {
                continue;
            }
            let machine = farm.node(node);
            let length = expected.and_then(|work| machine.duration(work, class)).unwrap_or(0);
            let setup = if farm.is_warm(node) { 0 } else { machine.setup };
            let ends = farm.now().saturating_add(length).saturating_add(setup);
            if farm.open_until(node).is_some_and(|until| ends <= until) {
                found = Some(node);
                break;
            }
        }
        found.is_some_and(|node| farm.start(node, job, task).is_ok())
    }

    fn next_task(&self, farm: &Farm, job: usize) -> Option<usize> {
        let entry = &farm.jobs[job];
        let first = *entry.waiting.first()?;
        if self.rule != QueueRule::ThreeFrames || !farm.has_shared_cache(job) {
            return Some(first);
        }
        let tasks = &entry.truth;
        let frames = tasks.iter().position(|task| task.task.frame().is_some())?;
        let last = tasks.iter().rposition(|task| matches!(task.task, Task::Frame(_)))?;
        let samples = [frames, frames + (last - frames) / 2, last];
        let mut of_samples = samples.into_iter().flat_map(|sample| entry.tasks_of(sample));
        if let Some(task) = of_samples.find(|task| entry.waiting.contains(task)) {
            return Some(task);
        }
        if samples.iter().any(|sample| !entry.measured.contains(sample)) {
            return None;
        }
        let Some(deadline) = farm.job(job).deadline else { return Some(first) };
        let mean = samples.iter().map(|&sample| u128::from(tasks[sample].work)).sum::<u128>() / 3;
        let rest = mean.saturating_mul(entry.left as u128);
        // One frame on a node of the job's mean speed, to finish that much before the deadline.
        let speed = u128::from(entry.running_speed).checked_div(entry.running as u128).unwrap_or(0).max(1);
        let frame = i64::try_from(mean.saturating_mul(1_000_000) / speed).unwrap_or(i64::MAX);
        let time = if entry.running == 0 { deadline } else { deadline.saturating_sub(frame) };
        let time = u128::try_from(time.saturating_sub(farm.now())).unwrap_or(0);
        let is_enough =
            u128::from(entry.running_speed).saturating_mul(time) >= rest.saturating_mul(1_000_000);
        (!is_enough).then_some(first)
    }
}

impl Policy for Queue {
    fn arrived(&mut self, farm: &mut Farm, job: usize) -> bool {
        // Every job is accepted.
        farm.job(job).deadline.is_some()
    }

    fn act(&mut self, farm: &mut Farm) -> Option<i64> {
        // No node is idle.
        farm.idle().next()?;
        let mut running: BTreeMap<Option<u64>, u64> = BTreeMap::new();
        for job in farm.open() {
            *running.entry(farm.job(job).project).or_default() += farm.jobs[job].running as u64;
        }
        let mut queue: BTreeSet<Key> = farm
            .open()
            .filter(|&job| !farm.jobs[job].waiting.is_empty())
            .map(|job| self.key(farm, job, &running))
            .collect();
        while let Some((had, priority, since, job)) = queue.pop_first() {
            if !self.start_one(farm, job) {
                continue;
            }
            if self.rule == QueueRule::FairShare {
                let project = farm.job(job).project;
                *running.entry(project).or_default() += 1;
                let jobs: Vec<usize> = queue
                    .iter()
                    .map(|key| key.3)
                    .filter(|&other| farm.job(other).project == project)
                    .chain([job])
                    .collect();
                queue.retain(|key| farm.job(key.3).project != project);
                queue.extend(jobs.into_iter().map(|job| self.key(farm, job, &running)));
            } else {
                queue.insert((had, priority, since, job));
            }
        }
        None
    }
}

impl Farm<'_> {
    fn share(&self, project: Option<u64>) -> u64 {
        let found = self.world.input.projects.iter().find(|entry| Some(entry.id) == project);
        u64::from(found.map_or(1, |entry| entry.share.max(1)))
    }

    /// Mean work of the job's finished frames.
    fn mean_work(&self, job: usize) -> Option<u64> {
        let entry = &self.jobs[job];
        let mean = entry.measured_work.checked_div(entry.measured.len() as u128)?;
        u64::try_from(mean).ok()
    }
}
