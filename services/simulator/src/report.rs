//! Results in numbers.

use forelight_planner::Interval;
use serde::Serialize;

use crate::policy::PolicyKind;
use crate::record::{Outcome, Record};
use crate::world::World;

const HOUR: f64 = 3.6e9;
/// Points of the curve of utilisation.
const POINTS: usize = 240;

/// One policy in one world. Shares are fractions. Withdrawn jobs count only in `withdrawn` and `cost`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The policy.
    pub policy: PolicyKind,
    /// Share of the nodes that it may use, in per cent.
    pub pool: u32,
    /// Jobs with a deadline that were not withdrawn.
    pub jobs: u64,
    /// Jobs that were withdrawn.
    pub withdrawn: u64,
    /// Jobs that never ended.
    pub unfinished: u64,
    /// Median hours from a job's release to its end. Zero if no job ended.
    pub median_hours: f64,
    /// Jobs whose deadline was promised.
    pub promised: u64,
    /// Promised jobs that were in time.
    pub promises_kept: u64,
    /// Jobs that were in time, promised or not.
    pub in_time: u64,
    /// Mean hours after the deadline of late jobs.
    pub mean_hours_late: f64,
    /// 95th percentile of hours after the deadline, zero for jobs in time.
    pub hours_late_p95: f64,
    /// Micro-units for all rented time.
    pub cost: i64,
    /// Lower bound of the cost, in micro-units.
    pub cost_bound: i64,
    /// Hours for which nodes were rented.
    pub rented_hours: f64,
    /// Share of the rented time that was spent on frames that were completed.
    pub useful: f64,
    /// Share of all open time, until the last job's end, in which frames were rendered.
    pub utilisation: f64,
    /// Hours from the start to the last job's end.
    pub makespan_hours: f64,
    /// Leases of tasks.
    pub attempts: u64,
    /// Attempts that were lost with their node.
    pub lost: u64,
    /// Attempts that were lost to closing windows.
    pub evicted: u64,
    /// Node failures.
    pub failures: u64,
    /// Plans made.
    pub plans: u64,
    /// Utilisation of the open time over time: hours from the start, fraction.
    pub curve: Vec<(f64, f64)>,
}

impl Report {
    /// Share of promises kept, 1 without promises.
    pub fn kept(&self) -> f64 {
        share(self.promises_kept, self.promised)
    }

    /// Share of jobs in time, 1 without jobs.
    pub fn on_time(&self) -> f64 {
        share(self.in_time, self.jobs)
    }

    /// Cost over bound.
    pub fn over_bound(&self) -> f64 {
        self.cost as f64 / self.cost_bound.max(1) as f64
    }
}

fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 { 1.0 } else { part as f64 / whole as f64 }
}

/// Outcomes of the deadlines of all jobs that were not withdrawn.
#[derive(Default)]
struct Deadlines {
    unfinished: u64,
    promised: u64,
    promises_kept: u64,
    in_time: u64,
    /// Hours after the deadline, for each job with a deadline, sorted.
    late: Vec<f64>,
}

impl Deadlines {
    fn of(world: &World, record: &Record) -> Self {
        let mut found = Deadlines::default();
        for (job, entry) in world.input.jobs.iter().zip(&record.jobs) {
            if entry.withdrawn.is_some() {
                continue;
            }
            found.unfinished += u64::from(entry.finish.is_none());
            let Some(deadline) = job.deadline else { continue };
            // Unfinished jobs count as finished at the end of the simulation.
            let finish = entry.finish.unwrap_or(record.end.max(deadline.saturating_add(1)));
            let kept = finish <= deadline;
            found.promised += u64::from(entry.promised);
            found.promises_kept += u64::from(entry.promised && kept);
            found.in_time += u64::from(kept);
            found.late.push(finish.saturating_sub(deadline).max(0) as f64 / HOUR);
        }
        found.late.sort_by(f64::total_cmp);
        found
    }
}

/// Summarises a record.
pub fn report(
    world: &World,
    policy: PolicyKind,
    pool: u32,
    plans: u64,
    cost_bound: i64,
    record: &Record,
) -> Report {
    let deadlines = Deadlines::of(world, record);
    let late = &deadlines.late;
    let rank = (late.len() * 95).div_ceil(100);
    let hours_late_p95 = rank.checked_sub(1).and_then(|rank| late.get(rank)).copied().unwrap_or(0.0);
    let were_late = late.iter().filter(|&&hours| hours > 0.0).count();
    let count = |outcome| record.attempts.iter().filter(|attempt| attempt.outcome == outcome).count() as u64;
    let useful: i128 = record
        .attempts
        .iter()
        .filter(|attempt| attempt.outcome == Outcome::Done)
        .map(|attempt| i128::from(attempt.end) - i128::from(attempt.start))
        .sum();
    let rented: i128 =
        record.rentals.iter().map(|rental| i128::from(rental.end) - i128::from(rental.start)).sum();
    let start = world.input.now;
    let worked: Vec<(i64, i64)> =
        record.attempts.iter().map(|attempt| (attempt.start, attempt.end)).collect();
    let open: Vec<(i64, i64)> = world
        .windows
        .iter()
        .flatten()
        .map(|&Interval { start, end }| (start, end.unwrap_or(i64::MAX)))
        .collect();
    let busy = spread_over(&worked, start, record.end);
    let free = spread_over(&open, start, record.end);
    let ratio = |busy: f64, free: f64| if free > 0.0 { busy / free } else { 0.0 };
    let length = (record.end - start).max(0) as f64 / HOUR;
    let curve = busy
        .iter()
        .zip(&free)
        .enumerate()
        .map(|(point, (&busy, &free))| (length * (point as f64 + 0.5) / POINTS as f64, ratio(busy, free)))
        .collect();
    Report {
        policy,
        pool,
        jobs: late.len() as u64,
        withdrawn: record.jobs.iter().filter(|job| job.withdrawn.is_some()).count() as u64,
        unfinished: deadlines.unfinished,
        median_hours: median_hours(world, record),
        promised: deadlines.promised,
        promises_kept: deadlines.promises_kept,
        in_time: deadlines.in_time,
        mean_hours_late: ratio(late.iter().sum(), were_late as f64),
        hours_late_p95,
        cost: record.rentals.iter().fold(0i64, |sum, rental| sum.saturating_add(rental.cost)),
        cost_bound,
        rented_hours: rented as f64 / HOUR,
        useful: ratio(useful as f64, rented as f64),
        utilisation: ratio(busy.iter().sum(), free.iter().sum()),
        makespan_hours: length,
        attempts: record.attempts.len() as u64,
        lost: count(Outcome::Lost),
        evicted: count(Outcome::Evicted),
        failures: record.failures,
        plans,
        curve,
    }
}

fn median_hours(world: &World, record: &Record) -> f64 {
    let jobs = world.input.jobs.iter().zip(&record.jobs);
    let mut times: Vec<i64> = jobs.filter_map(|(job, entry)| Some(entry.finish? - job.release)).collect();
    times.sort_unstable();
    times.get(times.len() / 2).map_or(0.0, |&time| time as f64 / HOUR)
}

/// Time of these intervals within each of [`POINTS`] equal parts.
fn spread_over(intervals: &[(i64, i64)], from: i64, until: i64) -> Vec<f64> {
    let mut parts = vec![0.0; POINTS];
    let step = ((until - from).max(1) as f64) / POINTS as f64;
    for &(start, end) in intervals {
        let (start, end) = (start.max(from), end.min(until));
        if start >= end {
            continue;
        }
        let (start, end) = ((start - from) as f64, (end - from) as f64);
        let first = ((start / step) as usize).min(POINTS - 1);
        let last = ((end / step) as usize).min(POINTS - 1);
        for (part, time) in parts.iter_mut().enumerate().take(last + 1).skip(first) {
            let (low, high) = (part as f64 * step, (part + 1) as f64 * step);
            *time += (end.min(high) - start.max(low)).max(0.0);
        }
    }
    parts
}
