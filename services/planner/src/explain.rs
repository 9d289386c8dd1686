//! Why a job waits.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::fairness::decayed_usage;
use crate::gaps::{Gap, Gaps};
use crate::intervals::Intervals;
use crate::model::{Booking, Input, InputError, Plan, Task, Verdict};
use crate::problem::{Problem, Work};

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
    /// No node that can render it is ready, and free for long enough, before its first task: nodes are set
    /// up, or close soon.
    NoRoom {
        /// When its first task starts.
        until: i64,
    },
    /// It could start earlier. Later is cheaper, and its deadline allows it.
    Cheaper,
    /// It could start earlier, on a node that would end its first task no sooner.
    Sooner,
    /// It could start earlier, and keeps its later booking: it stays within a budget, or where it was.
    Booked,
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
                let until = in_words(*until);
                write!(f, "waits because no node that can render it is free by its calendar before {until}")
            }
            Reason::Behind { jobs } => {
                write!(f, "waits because its nodes are booked for")?;
                for (index, (job, why)) in jobs.iter().enumerate() {
                    write!(f, "{} job {job}, which {why}", if index > 0 { "," } else { "" })?;
                }
                Ok(())
            }
            Reason::NoRoom { until } => {
                let until = in_words(*until);
                write!(f, "waits because no node that can render it is free for long enough before {until}")
            }
            Reason::Cheaper => write!(f, "waits because it is cheaper later and still in time"),
            Reason::Sooner => write!(f, "waits because it ends sooner where it is booked"),
            Reason::Booked => {
                write!(f, "waits because its booked start is later, although a node is free earlier")
            }
        }
    }
}

fn in_words(instant: i64) -> String {
    jiff::Timestamp::from_microsecond(instant).map_or_else(|_| instant.to_string(), |at| at.to_string())
}

/// Explains the jobs of `which` that start after their release, or not at all.
///
/// # Errors
/// If the input is invalid.
pub fn explain(
    input: &Input,
    plan: &Plan,
    which: impl Fn(u64) -> bool,
) -> Result<Vec<Explanation>, InputError> {
    input.check()?;
    let problem = Problem::new(input);
    let mut firsts: BTreeMap<u64, Booking> = BTreeMap::new();
    for booking in &plan.bookings {
        firsts.entry(booking.job).and_modify(|first| *first = *booking.min(first)).or_insert(*booking);
    }
    let in_time = plan.jobs.iter().filter(|entry| matches!(entry.verdict, Verdict::Feasible { .. }));
    let in_time: BTreeSet<u64> = in_time.map(|entry| entry.job).collect();
    let mut taken = Taken::new(&problem, plan);
    let mut found = Vec::new();
    for (index, work) in problem.jobs.iter().enumerate() {
        let release = work.release(input.now);
        let first = firsts.get(&work.job.id);
        let is_empty = work.frames.is_empty() && work.shared_cache.is_none();
        let begins = first.is_some_and(|first| first.start <= release);
        if is_empty || begins || !which(work.job.id) {
            continue;
        }
        let reason = match first {
            None => Reason::NoNode,
            Some(first) => reason(&problem, index, first, in_time.contains(&work.job.id), &mut taken),
        };
        let waits = first.map_or(i64::MAX, |first| first.start.saturating_sub(release));
        found.push(Explanation { job: work.job.id, waits, reason });
    }
    Ok(found)
}

/// What takes the nodes' time. Thousands of jobs may wait for the same nodes. So it is kept by class of
/// nodes, in the order of its starts, and what depends on class and release alone is worked out once.
struct Taken {
    /// The jobs that take some, sorted. Spans name them by their places here.
    jobs: Vec<u64>,
    /// By class of nodes: what is planned.
    planned: Vec<Vec<Span>>,
    /// By class of nodes: what is fixed.
    fixed: Vec<Vec<Span>>,
    /// By class of nodes and instant: when the first of them is in its calendar.
    openings: BTreeMap<(usize, i64), Option<i64>>,
    /// By class of nodes: what is left of their free time.
    left: BTreeMap<usize, Left>,
}

/// A stretch of a node's time.
struct Span {
    start: i64,
    end: i64,
    node: usize,
    /// The place of its job; `None` if it is no job's.
    job: Option<usize>,
}

/// The time of a class of nodes that nothing is planned in, after set-ups.
struct Left {
    gaps: Gaps,
    /// By node.
    of_nodes: BTreeMap<usize, Intervals>,
}

impl Left {
    fn of(problem: &Problem, class: usize, planned: &[Span]) -> Self {
        let free = |&node: &usize| {
            let windows = problem.windows[node].iter();
            let ready = windows.map(|window| (window.ready(problem.nodes[node]), window.end));
            (node, Intervals::union(ready.collect()))
        };
        let mut of_nodes: BTreeMap<usize, Intervals> = problem.classes[class].iter().map(free).collect();
        for span in planned {
            if let Some(free) = of_nodes.get_mut(&span.node) {
                free.take(span.start, span.end);
            }
        }
        let mut gaps = Gaps::new(&problem.looks);
        for (&node, free) in &of_nodes {
            free.iter().for_each(|(start, end)| gaps.insert(Gap { start, node, end }));
        }
        Left { gaps, of_nodes }
    }
}

impl Taken {
    fn new(problem: &Problem, plan: &Plan) -> Self {
        let fixed = &problem.input.fixed;
        let mut jobs: Vec<u64> = plan.bookings.iter().map(|booking| booking.job).collect();
        jobs.extend(fixed.iter().filter_map(|booking| booking.job));
        jobs.sort_unstable();
        jobs.dedup();
        let by_class = |spans: &mut dyn Iterator<Item = (u64, i64, i64, Option<u64>)>| {
            let mut lists: Vec<Vec<Span>> = problem.classes.iter().map(|_| Vec::new()).collect();
            for (node, start, end, job) in spans {
                if let Some(node) = problem.node(node) {
                    let job = job.and_then(|job| jobs.binary_search(&job).ok());
                    lists[problem.class_of[node]].push(Span { start, end, node, job });
                }
            }
            lists.iter_mut().for_each(|list| list.sort_unstable_by_key(|span| span.start));
            lists
        };
        let planned = by_class(&mut plan.bookings.iter().map(|it| (it.node, it.start, it.end, Some(it.job))));
        let fixed = by_class(&mut fixed.iter().map(|it| (it.node, it.start, it.end, it.job)));
        Self { jobs, planned, fixed, openings: BTreeMap::new(), left: BTreeMap::new() }
    }

    /// When the first node of these classes is in its calendar, from `release` on.
    fn opens(&mut self, problem: &Problem, classes: &[usize], release: i64) -> Option<i64> {
        let of_class = |class: usize| {
            let windows = problem.classes[class].iter().flat_map(|&node| &problem.windows[node]);
            windows.filter(|window| window.end > release).map(|window| window.start.max(release)).min()
        };
        let openings = &mut self.openings;
        let all = classes
            .iter()
            .filter_map(|&class| *openings.entry((class, release)).or_insert_with(|| of_class(class)));
        all.min()
    }

    fn left(&mut self, problem: &Problem, class: usize) -> &Left {
        self.left.entry(class).or_insert_with(|| Left::of(problem, class, &self.planned[class]))
    }

    /// When a task of this job could start, and when it would end, in what is left from its release on: for
    /// each class of nodes, if it could at all.
    fn places(&mut self, problem: &Problem, work: &Work, classes: &[usize], task: Task) -> Vec<(i64, i64)> {
        let release = work.release(problem.input.now);
        let place = |&class: &usize| {
            let duration = work.duration(problem.representative(class), task)?;
            let (_, start) = self.left(problem, class).gaps.first(release, duration)?;
            Some((start, start.saturating_add(duration)))
        };
        classes.iter().filter_map(place).collect()
    }

    /// When this booking could start at the earliest if it only moved within the free time before it.
    fn moved_up(&mut self, problem: &Problem, booking: &Booking, release: i64) -> Option<i64> {
        let node = problem.node(booking.node)?;
        let free = self.left(problem, problem.class_of[node]).of_nodes.get(&node)?;
        let (start, end) = free.before(booking.start)?;
        (end == booking.start && end > release).then_some(start.max(release))
    }

    /// How much of the time of these classes each job takes between two instants, of what is planned or of
    /// what is fixed.
    fn by_job(&self, lists: &[Vec<Span>], classes: &[usize], (from, to): (i64, i64)) -> Vec<i64> {
        let mut time = vec![0; self.jobs.len()];
        for span in within(lists, classes, (from, to)) {
            if let Some(job) = span.job {
                time[job] += span.end.min(to) - span.start.max(from);
            }
        }
        time
    }
}

/// The spans of these classes that have time between two instants.
fn within<'a>(
    lists: &'a [Vec<Span>],
    classes: &'a [usize],
    (from, to): (i64, i64),
) -> impl Iterator<Item = &'a Span> {
    classes.iter().flat_map(move |&class| {
        let list = &lists[class];
        let before = list.partition_point(|span| span.start < to);
        list[..before].iter().filter(move |span| span.end.min(to) > span.start.max(from))
    })
}

fn reason(problem: &Problem, index: usize, first: &Booking, in_time: bool, taken: &mut Taken) -> Reason {
    let work = &problem.jobs[index];
    let release = work.release(problem.input.now);
    let classes = if work.shared_cache.is_some() { &work.shared_cache_classes } else { &work.classes };
    let meanwhile = (release, first.start);
    match taken.opens(problem, classes, release) {
        None => return Reason::NoNode,
        Some(until) if until >= first.start && within(&taken.fixed, classes, meanwhile).next().is_none() => {
            return Reason::Calendar { until };
        }
        Some(_) => {}
    }
    let places = taken.places(problem, work, classes, shortest(work, first.task));
    let starts = places.iter().map(|&(start, _)| start).chain(taken.moved_up(problem, first, release));
    // A start that comes only shortly before the booked one does not explain the wait.
    let early = release.saturating_add(first.start.saturating_sub(release) / 2);
    if starts.min().is_some_and(|start| start <= early) {
        if in_time {
            return Reason::Cheaper;
        }
        let ends = taken.places(problem, work, classes, first.task);
        let is_sooner = ends.iter().all(|&(_, end)| end >= first.end);
        return if is_sooner { Reason::Sooner } else { Reason::Booked };
    }
    let holders = taken.by_job(&taken.planned, classes, meanwhile);
    let fixed = taken.by_job(&taken.fixed, classes, meanwhile);
    let names = &taken.jobs;
    let held = |time: Vec<i64>, is_fixed: bool| {
        let jobs = time.into_iter().enumerate().filter(|(_, time)| *time > 0);
        jobs.map(move |(job, time)| (Reverse(time), names[job], is_fixed))
    };
    let mut jobs: Vec<(Reverse<i64>, u64, bool)> =
        held(holders, false).filter(|(_, job, _)| *job != work.job.id).chain(held(fixed, true)).collect();
    if jobs.is_empty() {
        return Reason::NoRoom { until: first.start };
    }
    if jobs.len() > MOST_NAMED {
        jobs.select_nth_unstable(MOST_NAMED);
        jobs.truncate(MOST_NAMED);
    }
    jobs.sort_unstable();
    let why = |job, is_fixed| if is_fixed { Precedence::Fixed } else { precedence(problem, index, job) };
    Reason::Behind { jobs: jobs.into_iter().map(|(_, job, is_fixed)| (job, why(job, is_fixed))).collect() }
}

/// The job's shortest task of those that may start first, if one of them is booked like `first`.
fn shortest(work: &Work, first: Task) -> Task {
    let whole = work.frames.iter().filter(|frame| frame.division.allows(1));
    match (first, whole.min_by_key(|frame| frame.work)) {
        (Task::Frame(_), Some(frame)) => Task::Frame(frame.number),
        _ => first,
    }
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
