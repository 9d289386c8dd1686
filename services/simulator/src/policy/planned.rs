//! This project's policy: plans, replaced as things happen, at the confidence that each job asked for.
//!
//! * A job that comes in is planned with all promised jobs. It is promised if it can meet its deadline and no
//!   promise breaks. Otherwise it runs behind the promised jobs.
//! * Finished frames correct the forecast of their job ([`Learned`]). Finished jobs correct all forecasts.
//! * Frames have noise of their own, which capacity does not average out for the last ones. Plans use an
//!   earlier deadline, by the possible overrun of the longest of them ([`Planned::margin`]).
//! * New jobs, lost frames and intervals cause a new plan. In between, nodes follow their bookings.

mod learned;
mod queued;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use forelight_planner::{
    Booking, FixedBooking, Frame, Input, Interval, Job, Node, Plan, Power, SharedCache, Task, Verdict,
    WorkTotal, plan_quickly,
};

use crate::farm::{Farm, Policy, TaskState};
use crate::world::World;
use learned::Learned;
use queued::Queued;

const HOUR: i64 = 3_600_000_000;
/// The planner knows calendars this far beyond the last deadline.
const BEYOND: i64 = 72 * HOUR;
/// A lost frame is replanned at once if its job has less time left than this.
const URGENT: i64 = 24 * HOUR;
/// An overdue frame is expected to take this multiple of its time so far.
const OVERDUE: f64 = 1.25;
/// A late job may be later by its remaining time divided by this.
const PATIENCE: i64 = 8;
/// A job without a place in the plan aims at this much after its deadline.
const SOON: i64 = 12 * HOUR;

/// This project's policy.
#[derive(Clone, Debug)]
pub struct Planned {
    /// Microseconds between plans, if no job comes in.
    every: i64,
    /// When the next plan is due.
    next: i64,
    /// For each node, its next tasks.
    queues: Vec<VecDeque<Queued>>,
    promised: Vec<bool>,
    /// For each job, the new target once its deadline cannot be kept.
    targets: Vec<Option<i64>>,
    /// Promised jobs that the plan keeps.
    kept: BTreeSet<usize>,
    learned: Learned,
    plans: u64,
}

impl Planned {
    /// A policy that plans at least this often, in microseconds.
    pub fn new(world: &World, every: i64) -> Self {
        Planned {
            every: every.max(1),
            next: world.input.now,
            queues: vec![VecDeque::new(); world.input.nodes.len()],
            promised: vec![false; world.input.jobs.len()],
            targets: vec![None; world.input.jobs.len()],
            kept: BTreeSet::new(),
            learned: Learned::default(),
            plans: 0,
        }
    }

    /// Factor on a job's medians at its confidence, or at the median unless `confident`. Normal in the
    /// logarithm: the prior is the corrected forecast, the data are its finished frames.
    fn factor(&self, farm: &Farm, job: usize, confident: bool) -> f64 {
        let asked = farm.job(job);
        let z = asked.confidence.z();
        let reach = if z > 0.0 { z } else { forelight_planner::Confidence::P80.z() };
        let widening = self.learned.widening();
        let spread = libm::log(asked.common_factor(reach)) / reach * widening;
        let z = if confident { z } else { 0.0 };
        let (mut mean, mut variance) = (self.learned.shift(), spread * spread);
        let (sum, count, own) = self.measured(farm, job, widening);
        if count > 0.0 && variance > 0.0 {
            // A frame without noise of its own would determine the factor exactly.
            let noise = (own * own).max(1e-6) / count;
            let weight = variance / (variance + noise);
            mean += weight * (sum / count - mean);
            variance *= 1.0 - weight;
        }
        libm::exp(mean + z * libm::sqrt(variance))
    }

    /// For finished frames: sum of log(work / median), their number, and the standard deviation of one frame.
    fn measured(&self, farm: &Farm, job: usize, widening: f64) -> (f64, f64, f64) {
        let asked = farm.job(job);
        let own = asked.frames.first().map_or(0.0, |frame| asked.own_spread(frame)) * widening;
        let mut sum = 0.0;
        for &task in &farm.jobs[job].measured {
            let truth = &farm.jobs[job].truth[task];
            // Own factors have a mean of one.
            sum += libm::log(truth.work as f64 / truth.median.max(1) as f64) + own * own / 2.0;
        }
        (sum, farm.jobs[job].measured.len() as f64, own)
    }

    /// Margin of a job's plan before its deadline, in microseconds: the overrun of one of the last frames, at
    /// the job's confidence for all of them together.
    fn margin(&self, farm: &Farm, job: usize, longest: u64) -> i64 {
        let asked = farm.job(job);
        let own = asked.frames.first().map_or(0.0, |frame| asked.own_spread(frame)) * self.learned.widening();
        let Some(deadline) = asked.deadline.filter(|_| own > 0.0) else { return 0 };
        let nodes = farm.world.input.nodes.iter();
        let speeds: Vec<u64> =
            nodes.map(|node| node.speed_of(asked.class)).filter(|&speed| speed > 0).collect();
        let Some(&speed) = speeds.iter().min() else { return 0 };
        let last = farm.jobs[job].left.min(speeds.len()).max(1) as f64;
        let one = libm::pow(asked.confidence.probability(), 1.0 / last);
        let more = libm::exp(own * z_of(one) - own * own / 2.0) - 1.0;
        let margin = (longest as f64 * 1e6 / speed as f64 * more.max(0.0)) as i64;
        // A job with little time left uses it.
        margin.min(deadline.saturating_sub(farm.now()).max(0) / 3)
    }

    fn learn(&mut self, farm: &Farm) {
        for (job, entry) in farm.jobs.iter().enumerate() {
            if entry.left > 0 || entry.measured.is_empty() || !self.learned.counted.insert(job) {
                continue;
            }
            let median: u128 =
                entry.measured.iter().map(|&t| u128::from(farm.jobs[job].truth[t].median)).sum();
            let log = libm::log(entry.measured_work as f64 / median.max(1) as f64);
            let z = forelight_planner::Confidence::P80.z();
            self.learned.seen.push((log, libm::log(farm.job(job).common_factor(z)) / z));
        }
    }

    /// The planner's input.
    fn input(&mut self, farm: &Farm) -> Input {
        self.learn(farm);
        let now = farm.now();
        let known = &farm.world.input;
        let mut input =
            Input { now, projects: known.projects.clone(), half_life: known.half_life, ..Input::default() };
        let factors: BTreeMap<usize, f64> =
            farm.open().map(|job| (job, self.factor(farm, job, true))).collect();
        for node in 0..known.nodes.len() {
            if let Some((job, task, start)) = farm.running(node) {
                let end = self.expected_end(farm, node, job, task, start);
                let job = Some(farm.job(job).id);
                input.fixed.push(FixedBooking { node: farm.node(node).id, start: start.min(now), end, job });
            }
        }
        // Windows are planned to close earlier, by the possible overrun of a frame.
        let spare = self.spare_work(farm, &factors);
        let last = farm.open().filter_map(|job| farm.job(job).deadline).max().unwrap_or(now).max(now);
        let until = last.saturating_add(BEYOND);
        for (node, windows) in farm.world.windows.iter().enumerate().filter(|&(node, _)| farm.is_up(node)) {
            let first = windows.partition_point(|window| window.end.is_some_and(|end| end <= now));
            let machine = farm.node(node);
            let spare = machine.duration(spare, 0).unwrap_or(0);
            let earlier = |window: &Interval| Interval {
                start: window.start,
                end: window.end.map(|end| end.saturating_sub(spare).max(window.start)),
            };
            let calendar: Vec<Interval> =
                windows[first..].iter().take_while(|window| window.start < until).map(earlier).collect();
            let power = if farm.is_warm(node) { Power::On } else { Power::Standby };
            input.nodes.push(Node {
                calendar,
                power,
                available_from: now,
                maintenance: Vec::new(),
                ..machine.clone()
            });
        }
        // Fixed bookings need a node in the input.
        input.fixed.retain(|booking| input.nodes.binary_search_by_key(&booking.node, |node| node.id).is_ok());
        for (&job, &factor) in &factors {
            input.jobs.extend(self.rest_of(farm, job, factor));
        }
        input.movable = self.standing(farm, &input, &factors);
        input
    }

    /// Bookings of the parts of divided frames that wait: on the nodes that they were planned on, in that
    /// order, as early as can be. Each was weighed with the other parts of its frame, so a new plan keeps them.
    fn standing(&self, farm: &Farm, input: &Input, factors: &BTreeMap<usize, f64>) -> Vec<Booking> {
        let fixed: BTreeMap<u64, i64> =
            input.fixed.iter().map(|booking| (booking.node, booking.end)).collect();
        let mut standing = Vec::new();
        for (node, queue) in self.queues.iter().enumerate() {
            let machine = farm.node(node);
            let setup = if farm.is_warm(node) { 0 } else { machine.setup };
            let mut free = fixed.get(&machine.id).copied().unwrap_or(farm.now().saturating_add(setup));
            for queued in queue.iter().filter(|queued| queued.waits(farm)) {
                let part = queued
                    .part
                    .and_then(|(part, parts)| farm.jobs[queued.job].part(queued.task, part, parts));
                let place = part.unwrap_or(queued.task);
                let truth = &farm.jobs[queued.job].truth[place];
                let Some(factor) =
                    factors.get(&queued.job).filter(|_| matches!(truth.task, Task::Part { .. }))
                else {
                    break;
                };
                let work = bought(truth.median, *factor);
                let Some(end) = machine.duration(work, truth.class).and_then(|time| free.checked_add(time))
                else {
                    break;
                };
                let (job, task) = (farm.job(queued.job).id, Task::Frame(place as i64));
                standing.push(Booking { start: free, node: machine.id, job, task, end });
                free = end;
            }
        }
        standing
    }

    /// Work by which one frame in five exceeds its plan, averaged over the waiting frames.
    fn spare_work(&self, farm: &Farm, factors: &BTreeMap<usize, f64>) -> u64 {
        let (mut spare, mut count) = (0.0, 0.0);
        for (&job, factor) in factors {
            let more = self.overrun(farm, job) - 1.0;
            for &task in &farm.jobs[job].waiting {
                spare += farm.jobs[job].truth[task].median as f64 * factor * more;
                count += 1.0;
            }
        }
        if count > 0.0 { (spare / count) as u64 } else { 0 }
    }

    /// Ratio of work to plan that four frames in five do not exceed.
    fn overrun(&self, farm: &Farm, job: usize) -> f64 {
        let asked = farm.job(job);
        let own = asked.frames.first().map_or(0.0, |frame| asked.own_spread(frame)) * self.learned.widening();
        libm::exp(own * forelight_planner::Confidence::P80.z() - own * own / 2.0).max(1.0)
    }

    /// The rest of a job, at its confidence. `None` if everything runs.
    fn rest_of(&self, farm: &Farm, job: usize, factor: f64) -> Option<Job> {
        let asked = farm.job(job);
        let tasks = &farm.jobs[job].truth;
        let mut frames = Vec::new();
        let mut shared_cache: Option<SharedCache> = None;
        let mut release = asked.release.max(farm.now());
        // A task's index is its number for the planner.
        for &place in &farm.jobs[job].waiting {
            let task = &tasks[place];
            if task.task.is_shared_cache() {
                let (work, parts) = shared_cache.map_or((0, 0), |cache| (cache.work, cache.parts));
                let work = bought(task.median, factor).saturating_add(work);
                shared_cache = Some(SharedCache { class: task.class, work, parts: parts + 1 });
                continue;
            }
            // Parts of a divided frame are frames of their own for the planner.
            let work = bought(task.median, factor);
            frames.push(Frame { number: place as i64, work, division: task.division, ..Frame::default() });
        }
        if frames.is_empty() && shared_cache.is_none() {
            return None;
        }
        if shared_cache.is_none() {
            // Frames wait for the parts of the shared cache that run.
            let states = tasks.iter().zip(&farm.jobs[job].tasks).enumerate();
            for (place, (_, state)) in states.take_while(|(_, (task, _))| task.task.is_shared_cache()) {
                let TaskState::Held(attempt) = *state else { continue };
                let held = farm.attempt(attempt);
                let node = farm.world.input.nodes.binary_search_by_key(&held.node, |node| node.id).ok();
                let end = node.map(|node| self.expected_end(farm, node, job, place, held.start));
                release = release.max(end.unwrap_or(release));
            }
        }
        let total = frames.iter().fold(0u64, |sum, frame| sum.saturating_add(frame.work));
        let longest = frames.iter().map(|frame| frame.work).max().unwrap_or(0);
        let margin = self.margin(farm, job, longest);
        let behind = asked.deadline.is_some() && !self.promised[job];
        Some(Job {
            release,
            deadline: self.targets[job].or(asked.deadline.map(|deadline| deadline.saturating_sub(margin))),
            // Promised jobs come before others.
            priority: if behind { i32::MIN } else { asked.priority },
            total: WorkTotal { p50: total, p80: total, p95: total },
            shared_cache,
            frames,
            done: Vec::new(),
            ..asked.clone()
        })
    }

    /// When a running task should be done.
    fn expected_end(&self, farm: &Farm, node: usize, job: usize, task: usize, start: i64) -> i64 {
        let truth = &farm.jobs[job].truth[task];
        let work = (truth.median as f64 * self.factor(farm, job, false)).ceil() as u64;
        let expected = farm.node(node).duration(work, truth.class).unwrap_or(i64::MAX);
        let elapsed = farm.now().saturating_sub(start).max(0);
        let overdue = (elapsed as f64 * OVERDUE) as i64;
        let end = start.saturating_add(expected.max(overdue)).max(farm.now() + 1);
        farm.open_until(node).map_or(end, |until| end.min(until))
    }

    /// Makes a plan and lists the jobs that it keeps. `None` if the input is invalid.
    fn make(&mut self, farm: &Farm) -> Option<(Plan, BTreeSet<usize>)> {
        let input = self.input(farm);
        let made = plan_quickly(&input).ok()?;
        self.plans += 1;
        let mut kept: BTreeSet<usize> = farm.open().collect();
        for entry in &made.jobs {
            let Some(job) = farm.place_of(entry.job) else { continue };
            let deadline = farm.job(job).deadline.unwrap_or(i64::MAX);
            let finish = entry.verdict.finish().filter(|_| entry.verdict.is_kept());
            if finish.is_none_or(|finish| finish > deadline) {
                kept.remove(&job);
            }
        }
        Some((made, kept))
    }

    fn adopt(&mut self, farm: &Farm, made: &Plan, kept: BTreeSet<usize>) {
        self.queues.iter_mut().for_each(VecDeque::clear);
        // Bookings are ordered by start.
        for booking in &made.bookings {
            let Some(node) = farm.world.input.nodes.binary_search_by_key(&booking.node, |node| node.id).ok()
            else {
                continue;
            };
            let Some(job) = farm.place_of(booking.job) else { continue };
            // Parts of the shared cache are the waiting ones, in order.
            let part_of_cache = |part: u32| farm.jobs[job].waiting.iter().nth(part as usize).copied();
            let (task, part) = match booking.task {
                Task::SharedCache => (part_of_cache(0), None),
                Task::SharedCachePart { part, .. } => (part_of_cache(part), None),
                Task::Frame(place) => (usize::try_from(place).ok(), None),
                Task::Part { frame, part, parts } => (usize::try_from(frame).ok(), Some((part, parts))),
            };
            if let Some(task) = task {
                let length = booking.end.saturating_sub(booking.start);
                self.queues[node].push_back(Queued { job, task, part, length });
            }
        }
        self.aim(farm, made);
        self.kept = kept;
        self.next = farm.now().saturating_add(self.every);
    }

    /// Sets a late job's target to its earliest end, and back to its deadline once it is in time again.
    fn aim(&mut self, farm: &Farm, made: &Plan) {
        for entry in &made.jobs {
            let Some(job) = farm.place_of(entry.job) else { continue };
            let Some(deadline) = farm.job(job).deadline else { continue };
            let patient = |finish: i64| finish.saturating_add(finish.saturating_sub(farm.now()) / PATIENCE);
            let before = self.targets[job].unwrap_or(i64::MAX);
            self.targets[job] = match &entry.verdict {
                Verdict::Feasible { finish, .. } | Verdict::NoDeadline { finish } if *finish <= deadline => {
                    None
                }
                Verdict::Feasible { finish, .. } | Verdict::NoDeadline { finish } => {
                    Some(before.min(patient(*finish)))
                }
                Verdict::Late { finish, .. } => Some(patient(*finish)),
                Verdict::Unplaced { .. } => Some(deadline.max(farm.now()).saturating_add(SOON)),
            };
        }
    }

    /// Starts the first task of a node's queue that can start and fits its window.
    fn start_next(&mut self, farm: &mut Farm, node: usize) {
        let Some(until) = farm.open_until(node) else { return };
        let setup = if farm.is_warm(node) { 0 } else { farm.node(node).setup };
        let mut place = 0;
        while let Some(&next) = self.queues[node].get(place) {
            if !next.waits(farm) {
                self.queues[node].remove(place);
                continue;
            }
            let length = (next.length as f64 * self.overrun(farm, next.job)) as i64;
            if farm.now().saturating_add(setup).saturating_add(length) > until {
                // Later bookings are meant for a later window.
                return;
            }
            if next.start(farm, node) {
                self.queues[node].remove(place);
                return;
            }
            place += 1;
        }
    }
}

impl Policy for Planned {
    fn arrived(&mut self, farm: &mut Farm, job: usize) -> bool {
        // Plan the job as if it were promised.
        self.promised[job] = farm.job(job).deadline.is_some();
        let Some((made, kept)) = self.make(farm) else {
            self.promised[job] = false;
            return false;
        };
        let pushed = self.kept.iter().any(|&other| {
            self.promised[other]
                && !kept.contains(&other)
                && farm.jobs[other].left > 0
                && !farm.jobs[other].withdrawn
        });
        if kept.contains(&job) && !pushed {
            self.adopt(farm, &made, kept);
        } else {
            self.promised[job] = false;
            // The old plan stays until a new one has this job behind the others.
            self.next = self.next.min(farm.now().saturating_add(self.every / 4));
        }
        self.promised[job]
    }

    fn act(&mut self, farm: &mut Farm) -> Option<i64> {
        for &job in &farm.given_back {
            // A job without a deadline should end early.
            let urgent =
                farm.job(job).deadline.is_none_or(|deadline| deadline < farm.now().saturating_add(URGENT));
            let wait = if urgent { 0 } else { self.every / 4 };
            self.next = self.next.min(farm.now().saturating_add(wait));
        }
        if self.next <= farm.now() && farm.open().next().is_some() {
            match self.make(farm) {
                Some((made, kept)) => self.adopt(farm, &made, kept),
                None => self.next = farm.now().saturating_add(self.every),
            }
        }
        let idle: Vec<usize> = farm.idle().filter(|&node| !self.queues[node].is_empty()).collect();
        for node in idle {
            self.start_next(farm, node);
        }
        farm.open().next().map(|_| self.next)
    }

    fn shares_cache(&self, world: &World, job: usize) -> bool {
        // The cheaper way, like the service.
        let share = world.chances.own_cache;
        share == 0.0 || share * world.input.jobs[job].frames.len() as f64 >= 1.0
    }

    fn plans(&self) -> u64 {
        self.plans
    }
}

impl Farm<'_> {
    /// Index of a job in the jobs by id.
    fn place_of(&self, id: u64) -> Option<usize> {
        self.world.input.jobs.binary_search_by_key(&id, |job| job.id).ok()
    }
}

/// Work to book for this median.
fn bought(median: u64, factor: f64) -> u64 {
    (median as f64 * factor).ceil().max(1.0) as u64
}

/// Quantile of the standard normal distribution, by bisection, between −9 and 9.
fn z_of(probability: f64) -> f64 {
    let (mut low, mut high) = (-9.0f64, 9.0f64);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        // The upper tail keeps its digits where the probability is near one.
        if libm::erfc(middle / std::f64::consts::SQRT_2) / 2.0 > 1.0 - probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::z_of;

    #[test]
    fn quantiles_of_the_normal_distribution_are_found() {
        for (probability, z) in [(0.5, 0.0), (0.8, 0.841_621), (0.95, 1.644_854), (0.999, 3.090_232)] {
            assert!((z_of(probability) - z).abs() < 1e-6, "{probability}");
        }
    }
}
