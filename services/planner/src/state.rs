//! A plan under construction: every node's lane, and the place of each task.

use std::collections::{BTreeMap, BTreeSet};

use crate::admission::{Admission, IN_A_MICRO_UNIT};
use crate::lane::{Fit, Lane, Market, Prefer, Wanted};
use crate::model::{Booking, SharedCache, Task};
use crate::problem::Problem;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Placed {
    pub node: usize,
    pub start: i64,
    pub end: i64,
    pub task: Task,
}

/// Rank, node id, node index, and the place on the node.
type Candidate = ((i128, i64, i64), u64, usize, Fit);

#[derive(Clone, Copy, Debug)]
pub(crate) struct Search<'s> {
    pub class_of_work: u32,
    pub work: u64,
    pub release: i64,
    pub latest_end: i64,
    /// Classes of nodes to search.
    pub classes: &'s [usize],
    pub prefer: Prefer,
    pub only: Only,
    /// Add to the cost what others would pay for the time.
    pub for_others: bool,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Only {
    /// The place must cost less than this.
    pub below: i64,
    /// A node to leave out.
    pub except: Option<usize>,
    /// Skips plainly billed nodes on which nothing was freed since this count of [`State::clock`], for tasks
    /// that found no place there at that time. Zero skips none.
    pub freed_since: u64,
}

impl Only {
    pub const ANY: Self = Self { below: i64::MAX, except: None, freed_since: 0 };
}

/// What others would pay for the time of a class of nodes, by the linear programme.
struct Priced<'s> {
    admission: &'s Admission,
    class: usize,
    for_others: bool,
}

impl Market for Priced<'_> {
    fn worth(&self, start: i64, end: i64) -> i128 {
        if self.for_others { self.admission.worth(self.class, start, end) } else { 0 }
    }

    fn cheaper_from(&self, instant: i64) -> Option<i64> {
        self.admission.cheaper_from(self.class, instant).filter(|_| self.for_others)
    }

    fn is_scarce(&self, instant: i64) -> bool {
        self.admission.is_scarce(self.class, instant)
    }
}

/// A plan under construction.
#[derive(Clone)]
pub(crate) struct State<'p, 'a> {
    pub problem: &'p Problem<'a>,
    /// Knows where time is scarce.
    pub admission: &'p Admission,
    /// List scheduling respects what others would pay for a place, and the slots that the programme gave a
    /// job.
    pub for_others: bool,
    pub lanes: Vec<Lane>,
    /// By job, in the order of placement.
    pub placed: Vec<Vec<Placed>>,
    /// By job: the first tasks of `placed` that must not move.
    pub kept: Vec<usize>,
    /// Counts releases of booked time.
    pub clock: u64,
}

impl<'s> Search<'s> {
    /// The earliest end of this much work of a job's frames, whenever that is.
    pub fn early(state: &State<'s, '_>, job: usize, release: i64, work: u64) -> Self {
        let of_job = &state.problem.jobs[job];
        Search {
            class_of_work: of_job.job.class,
            work,
            release,
            latest_end: i64::MAX,
            classes: &of_job.classes,
            prefer: Prefer::Early,
            only: Only::ANY,
            for_others: state.for_others,
        }
    }
}

impl<'p, 'a> State<'p, 'a> {
    pub fn new(problem: &'p Problem<'a>, admission: &'p Admission) -> Self {
        let lanes =
            problem.nodes.iter().zip(&problem.windows).map(|(node, windows)| Lane::new(node, windows));
        State {
            problem,
            admission,
            for_others: true,
            lanes: lanes.collect(),
            placed: vec![Vec::new(); problem.jobs.len()],
            kept: vec![0; problem.jobs.len()],
            clock: 0,
        }
    }

    /// Keeps these bookings where they are valid. Shared caches come first, since frames depend on them.
    pub fn keep(&mut self, bookings: &[Booking]) {
        let mut sorted = bookings.to_vec();
        sorted.sort_unstable_by_key(|booking| (!booking.task.is_shared_cache(), *booking));
        sorted.dedup();
        sorted.iter().for_each(|booking| self.keep_one(booking));
        self.drop_partial_frames();
    }

    fn keep_one(&mut self, booking: &Booking) {
        let problem = self.problem;
        let Some((job, node)) = problem.job(booking.job).zip(problem.node(booking.node)) else {
            return;
        };
        let work = &problem.jobs[job];
        let duration = work.duration(problem.nodes[node], booking.task);
        let is_right = duration.and_then(|duration| booking.start.checked_add(duration)) == Some(booking.end)
            && self.earliest(job, booking.task).is_some_and(|earliest| earliest <= booking.start)
            && self.lanes[node].is_free(booking.start, booking.end)
            && !self.placed[job].iter().any(|placed| excludes(placed.task, booking.task));
        if is_right {
            self.book(job, Placed { node, start: booking.start, end: booking.end, task: booking.task });
            self.kept[job] += 1;
        }
    }

    /// Frames of which some parts cannot be kept lose the others too, and are placed anew as a whole.
    fn drop_partial_frames(&mut self) {
        for job in 0..self.placed.len() {
            let mut there: BTreeMap<i64, u32> = BTreeMap::new();
            for placed in &self.placed[job] {
                if let Task::Part { frame, .. } = placed.task {
                    *there.entry(frame).or_default() += 1;
                }
            }
            let is_partial = |placed: &Placed| match placed.task {
                Task::Part { frame, parts, .. } => there.get(&frame).is_some_and(|&count| count < parts),
                _ => false,
            };
            let (partial, whole): (Vec<Placed>, Vec<Placed>) =
                self.placed[job].iter().copied().partition(is_partial);
            self.kept[job] -= partial.len();
            partial.into_iter().for_each(|placed| self.free(placed));
            self.placed[job] = whole;
        }
    }

    pub fn booking(&self, job: usize, placed: &Placed) -> Booking {
        let Placed { node, start, end, task } = *placed;
        Booking { start, node: self.problem.nodes[node].id, job: self.problem.jobs[job].job.id, task, end }
    }

    /// The earliest start of a task: its release and, for a frame, the end of the shared cache. `None` while
    /// the shared cache has no place.
    pub fn earliest(&self, job: usize, task: Task) -> Option<i64> {
        let work = &self.problem.jobs[job];
        let release = work.release(self.problem.input.now);
        if work.shared_cache.is_none() || task.is_shared_cache() {
            return Some(release);
        }
        if self.misses_shared_cache(job) {
            return None;
        }
        let cache_parts = self.placed[job].iter().filter(|placed| placed.task.is_shared_cache());
        cache_parts.map(|part| part.end.max(release)).max()
    }

    /// The best place on these classes of nodes. Ties go to the node with the lowest id.
    pub fn find(&self, search: &Search) -> Option<(usize, Fit)> {
        let problem = self.problem;
        let mut classes: Vec<(i64, i64, usize)> = search
            .classes
            .iter()
            .filter_map(|&class| {
                let node = problem.representative(class);
                let duration = node.duration(search.work, search.class_of_work)?;
                Some((node.price(duration, false), duration, class))
            })
            .collect();
        classes.sort_unstable();
        let mut best: Option<Candidate> = None;
        for (_, duration, class) in classes {
            let wanted = Wanted { release: search.release, latest_end: search.latest_end, duration };
            let market = Priced { admission: self.admission, class, for_others: search.for_others };
            // Empty nodes of one class are alike, so the first is enough.
            let mut empty: Option<usize> = None;
            for &index in &problem.classes[class] {
                let (node, lane) = (problem.nodes[index], &self.lanes[index]);
                if lane.is_empty() {
                    if empty.is_some_and(|first| problem.windows[first] == problem.windows[index]) {
                        continue;
                    }
                    if search.only.except != Some(index) {
                        empty = empty.or(Some(index));
                    }
                }
                if lane.freed < search.only.freed_since && node.is_plainly_billed()
                    || lane.is_too_full(duration)
                {
                    continue;
                }
                let least = lane.least_added_cost(node, duration);
                let hopeless = least >= search.only.below
                    || search.prefer == Prefer::Cheap
                        && best.is_some_and(|(rank, ..)| i128::from(least) * IN_A_MICRO_UNIT > rank.0);
                if hopeless || search.only.except == Some(index) {
                    continue;
                }
                let Some(fit) = lane.fit(node, &wanted, search.prefer, &market) else {
                    continue;
                };
                let rank = fit.rank(search.prefer);
                if best.is_none_or(|(least, id, ..)| (rank, node.id) < (least, id)) {
                    best = Some((rank, node.id, index, fit));
                }
            }
        }
        best.map(|(_, _, node, fit)| (node, fit))
    }

    pub fn book(&mut self, job: usize, placed: Placed) {
        let node = self.problem.nodes[placed.node];
        self.lanes[placed.node].book(node, placed.start, placed.end);
        self.placed[job].push(placed);
    }

    pub fn unbook(&mut self, job: usize, placed: Placed) {
        self.free(placed);
        self.placed[job].retain(|other| *other != placed);
    }

    /// Removes these places of the job.
    pub fn unbook_all(&mut self, job: usize, places: &[Placed]) {
        places.iter().for_each(|&placed| self.free(placed));
        let tasks: BTreeSet<Task> = places.iter().map(|placed| placed.task).collect();
        self.placed[job].retain(|placed| !tasks.contains(&placed.task));
    }

    /// Places of the job's tasks for which this holds, with those of all other parts of their frames.
    pub fn with_other_parts(&self, job: usize, is_wanted: impl Fn(&Placed) -> bool) -> Vec<Placed> {
        let all = || self.placed[job].iter().copied();
        let divided: BTreeSet<i64> = all()
            .filter(|placed| matches!(placed.task, Task::Part { .. }) && is_wanted(placed))
            .filter_map(|placed| placed.task.frame())
            .collect();
        let is_part = |placed: &Placed| placed.task.frame().is_some_and(|frame| divided.contains(&frame));
        all().filter(|placed| is_wanted(placed) || is_part(placed)).collect()
    }

    fn free(&mut self, placed: Placed) {
        let (node, lane) = (self.problem.nodes[placed.node], &mut self.lanes[placed.node]);
        lane.unbook(node, placed.start, placed.end);
        lane.freed = self.clock;
        self.clock += 1;
    }

    /// Removes all but the first `count` placed tasks of the job.
    pub fn unbook_after(&mut self, job: usize, count: usize) {
        let count = count.min(self.placed[job].len());
        for last in self.placed[job].split_off(count).into_iter().rev() {
            self.free(last);
        }
    }

    pub fn cost(&self) -> i64 {
        let rentals = self.lanes.iter().zip(&self.problem.nodes).flat_map(|(lane, node)| lane.rentals(node));
        rentals.fold(0i64, |sum, rental| sum.saturating_add(rental.cost))
    }

    pub fn finish(&self, job: usize) -> i64 {
        let release = self.problem.jobs[job].release(self.problem.input.now);
        self.placed[job].iter().map(|placed| placed.end).max().unwrap_or(release)
    }

    /// Numbers of the job's frames without a place.
    pub fn missing(&self, job: usize) -> Vec<i64> {
        let there: BTreeSet<i64> = self.placed[job].iter().filter_map(|placed| placed.task.frame()).collect();
        let all = self.problem.jobs[job].frames.iter().map(|frame| frame.number);
        let mut missing: Vec<i64> = all.filter(|number| !there.contains(number)).collect();
        missing.sort_unstable();
        missing
    }

    /// Tasks of the shared cache without a place.
    pub fn missing_cache_parts(&self, job: usize) -> Vec<Task> {
        let all = self.problem.jobs[job].job.shared_cache.into_iter().flat_map(SharedCache::tasks);
        all.filter(|&task| !self.placed[job].iter().any(|placed| placed.task == task)).collect()
    }

    /// Whether the job has a shared cache of which some part has no place.
    pub fn misses_shared_cache(&self, job: usize) -> bool {
        !self.missing_cache_parts(job).is_empty()
    }

    /// The number of frames and shared-cache tasks without a place.
    pub fn missing_tasks(&self, job: usize) -> usize {
        self.missing(job).len() + self.missing_cache_parts(job).len()
    }

    /// Whether everything is placed, by the deadline if there is one.
    pub fn is_kept(&self, job: usize) -> bool {
        let deadline = self.problem.jobs[job].job.deadline;
        !self.misses_shared_cache(job)
            && self.missing(job).is_empty()
            && deadline.is_none_or(|deadline| self.finish(job) <= deadline)
    }
}

/// Whether a job cannot have both tasks.
fn excludes(one: Task, other: Task) -> bool {
    match (one, other) {
        (Task::SharedCachePart { part: p, parts: m }, Task::SharedCachePart { part: q, parts: n }) => {
            p == q || m != n
        }
        (Task::Part { frame: a, part: p, parts: m }, Task::Part { frame: b, part: q, parts: n }) => {
            a == b && (p == q || m != n)
        }
        _ => one.frame() == other.frame(),
    }
}
