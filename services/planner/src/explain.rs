//! Why a job waits.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::fairness::decayed_usage;
use crate::model::{Booking, Input, InputError, Plan};
use crate::problem::Problem;

const MOST_NAMED: usize = 3;

/// Why a job's first task does not start at its release.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Explanation {
    /// The job.
    pub job: u64,
    /// Microseconds from the release to the first task.
    pub waits: i64,
    /// The reason.
    pub reason: Reason,
}

/// What a job waits for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Reason {
    /// No node can ever render it: none has a speed for its class of work and a long enough free time.
    NoNode,
    /// No node that can render it is in its calendar before this instant.
    Calendar {
        /// When the first such node is.
        until: i64,
    },
    /// The nodes are booked for other jobs.
    Behind {
        /// The jobs that hold most of the nodes' time meanwhile, and why each goes first.
        jobs: Vec<(u64, Precedence)>,
    },
    /// It could start now. Later is cheaper, and its deadline allows it.
    Cheaper,
}

/// Why another job goes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Precedence {
    /// Its booking is fixed.
    Fixed,
    /// It has a deadline, and the waiting job has none.
    Deadline,
    /// Its deadline is earlier.
    EarlierDeadline,
    /// Its priority is higher.
    Priority,
    /// Its project used less of its share. Both numbers are node time per unit of share.
    Share {
        /// Of the waiting job's project.
        mine: i64,
        /// Of the other job's project.
        theirs: i64,
    },
    /// It was booked earlier.
    Earlier,
}

impl fmt::Display for Precedence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Precedence::Fixed => write!(f, "is fixed"),
            Precedence::Deadline => write!(f, "has a deadline"),
            Precedence::EarlierDeadline => write!(f, "has an earlier deadline"),
            Precedence::Priority => write!(f, "has a higher priority"),
            Precedence::Share { mine, theirs } => {
                let hours = |time: &i64| time / 3_600_000_000;
                write!(
                    f,
                    "belongs to a project that used {} node hours per share, this job's project used {}",
                    hours(theirs),
                    hours(mine)
                )
            }
            Precedence::Earlier => write!(f, "was booked earlier"),
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Reason::NoNode => write!(f, "waits because no node can ever render it"),
            Reason::Calendar { until } => {
                let instant = jiff::Timestamp::from_microsecond(*until);
                let until = instant.map_or_else(|_| until.to_string(), |instant| instant.to_string());
                write!(f, "waits because no node that can render it is free by its calendar before {until}")
            }
            Reason::Behind { jobs } => {
                write!(f, "waits because its nodes are booked for")?;
                for (index, (job, why)) in jobs.iter().enumerate() {
                    write!(f, "{} job {job}, which {why}", if index > 0 { "," } else { "" })?;
                }
                Ok(())
            }
            Reason::Cheaper => write!(f, "waits because it is cheaper later and still in time"),
        }
    }
}

/// Explains every job that starts after its release, or not at all.
///
/// # Errors
/// If the input is invalid.
pub fn explain(input: &Input, plan: &Plan) -> Result<Vec<Explanation>, InputError> {
    input.check()?;
    let problem = Problem::new(input);
    let mut by_node: BTreeMap<u64, Vec<&Booking>> = BTreeMap::new();
    let mut firsts: BTreeMap<u64, i64> = BTreeMap::new();
    for booking in &plan.bookings {
        by_node.entry(booking.node).or_default().push(booking);
        firsts
            .entry(booking.job)
            .and_modify(|first| *first = booking.start.min(*first))
            .or_insert(booking.start);
    }
    let mut found = Vec::new();
    for (index, work) in problem.jobs.iter().enumerate() {
        let release = work.release(input.now);
        let first = firsts.get(&work.job.id).copied();
        let is_empty = work.frames.is_empty() && work.shared_cache.is_none();
        if is_empty || first.is_some_and(|first| first <= release) {
            continue;
        }
        let reason = reason(&problem, index, first, &by_node);
        let waits = first.map_or(i64::MAX, |first| first.saturating_sub(release));
        found.push(Explanation { job: work.job.id, waits, reason });
    }
    Ok(found)
}

fn reason(
    problem: &Problem,
    index: usize,
    first: Option<i64>,
    by_node: &BTreeMap<u64, Vec<&Booking>>,
) -> Reason {
    let work = &problem.jobs[index];
    let release = work.release(problem.input.now);
    let Some(first) = first else { return Reason::NoNode };
    let classes = if work.shared_cache.is_some() { &work.shared_cache_classes } else { &work.classes };
    let able: Vec<usize> = classes.iter().flat_map(|&class| problem.classes[class].iter().copied()).collect();
    let opens = able
        .iter()
        .flat_map(|&node| &problem.windows[node])
        .filter(|window| window.end > release)
        .map(|window| window.start.max(release))
        .min();
    let fixed_before = |instant: i64| {
        let ids: Vec<u64> = able.iter().map(|&node| problem.nodes[node].id).collect();
        let here = move |fixed: &&crate::model::FixedBooking| {
            ids.contains(&fixed.node) && fixed.start < instant && fixed.end > release
        };
        problem.input.fixed.iter().filter(here)
    };
    match opens {
        None => return Reason::NoNode,
        Some(until) if until >= first && fixed_before(first).next().is_none() => {
            return Reason::Calendar { until };
        }
        Some(_) => {}
    }
    // How much of the nodes' time each job holds between release and start.
    let mut holders: BTreeMap<u64, i64> = BTreeMap::new();
    let mut some_node_is_free = false;
    for &node in &able {
        let mut is_taken =
            !problem.windows[node].iter().any(|window| window.start <= release && release < window.end);
        for booking in by_node.get(&problem.nodes[node].id).into_iter().flatten() {
            let (start, end) = (booking.start.max(release), booking.end.min(first));
            if start < end {
                *holders.entry(booking.job).or_default() += end - start;
                is_taken |= booking.start <= release;
            }
        }
        some_node_is_free |= !is_taken;
    }
    holders.remove(&work.job.id);
    let mut fixed: BTreeMap<u64, i64> = BTreeMap::new();
    for booking in fixed_before(first) {
        if let Some(job) = booking.job {
            *fixed.entry(job).or_default() += booking.end.min(first) - booking.start.max(release);
        }
    }
    if some_node_is_free || (holders.is_empty() && fixed.is_empty()) {
        return Reason::Cheaper;
    }
    let mut jobs: Vec<(i64, u64, Precedence)> =
        holders.into_iter().map(|(job, time)| (time, job, precedence(problem, index, job))).collect();
    jobs.extend(fixed.into_iter().map(|(job, time)| (time, job, Precedence::Fixed)));
    jobs.sort_unstable_by_key(|&(time, job, _)| (std::cmp::Reverse(time), job));
    Reason::Behind { jobs: jobs.into_iter().take(MOST_NAMED).map(|(_, job, why)| (job, why)).collect() }
}

fn precedence(problem: &Problem, waiting: usize, other: u64) -> Precedence {
    let mine = problem.jobs[waiting].job;
    let Some(theirs) = problem.job(other).map(|job| problem.jobs[job].job) else { return Precedence::Fixed };
    match (mine.deadline, theirs.deadline) {
        (None, Some(_)) => Precedence::Deadline,
        (Some(mine), Some(theirs)) if theirs < mine => Precedence::EarlierDeadline,
        _ if theirs.priority > mine.priority => Precedence::Priority,
        (None, None) if mine.project != theirs.project => {
            let used = |project: Option<u64>| {
                let found = problem.input.projects.iter().find(|entry| Some(entry.id) == project);
                found.map_or(0, |entry| {
                    let used = decayed_usage(entry, problem.input.now, problem.input.half_life);
                    used / i64::from(entry.share.max(1))
                })
            };
            Precedence::Share { mine: used(mine.project), theirs: used(theirs.project) }
        }
        _ => Precedence::Earlier,
    }
}
