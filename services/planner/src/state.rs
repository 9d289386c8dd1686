//! A plan under construction: every node's lane, and the place of each task.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use crate::admission::Admission;
use crate::lane::Lane;
use crate::model::{Booking, SharedCache, Task};
use crate::pool::Pool;
use crate::problem::Problem;

/// Per cent of what others would pay that their time counts.
const FOR_OTHERS: i128 = 120;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Placed {
    pub node: usize,
    pub start: i64,
    pub end: i64,
    pub task: Task,
}

/// A plan under construction.
#[derive(Clone)]
pub(crate) struct State<'p, 'a> {
    pub problem: &'p Problem<'a>,
    /// Knows where time is scarce.
    pub admission: &'p Admission,
    /// List scheduling respects what others would pay for a place, and the slots that the programme gave a
    /// job.
    pub is_selfless: bool,
    pub lanes: Vec<Lane>,
    /// By class of nodes.
    pub pools: Vec<Pool>,
    /// By job, in the order of placement: its shared cache first.
    pub placed: Vec<Vec<Placed>>,
    /// By job: the first tasks of `placed` that must not move.
    pub kept: Vec<usize>,
}

impl<'p, 'a> State<'p, 'a> {
    pub fn new(problem: &'p Problem<'a>, admission: &'p Admission) -> Self {
        let nodes = problem.nodes.iter().zip(&problem.windows);
        let lanes: Vec<Lane> = nodes.map(|(node, windows)| Lane::new(node, windows)).collect();
        let pools = problem.supply.gaps.iter().map(Pool::unused).collect();
        State {
            problem,
            admission,
            is_selfless: true,
            lanes,
            pools,
            placed: vec![Vec::new(); problem.jobs.len()],
            kept: vec![0; problem.jobs.len()],
        }
    }

    /// Keeps these bookings where they are valid. Shared caches come first, since frames depend on them.
    pub fn keep(&mut self, bookings: &[Booking]) {
        if bookings.is_empty() {
            return;
        }
        let problem = self.problem;
        // Job by job, then node by node: what is looked at then lies close together in memory, which is several
        // times as fast on a large farm.
        let mut by_job: Vec<Vec<Placed>> = vec![Vec::new(); problem.jobs.len()];
        for &Booking { start, node, job, task, end } in bookings {
            if let Some((job, node)) = problem.job(job).zip(problem.node(node)) {
                by_job[job].push(Placed { node, start, end, task });
            }
        }
        let mut caches: Vec<Candidate> = Vec::new();
        let mut by_node: Vec<Vec<Candidate>> = vec![Vec::new(); problem.nodes.len()];
        for (job, of_job) in by_job.into_iter().enumerate() {
            let work = &problem.jobs[job];
            self.placed[job].reserve(of_job.len());
            for placed in of_job {
                let Some(place) = work.place_of(placed.task) else { continue };
                let duration = work.duration_at(place, problem.nodes[placed.node], placed.task);
                if duration.and_then(|duration| placed.start.checked_add(duration)) == Some(placed.end) {
                    let list =
                        if placed.task.is_shared_cache() { &mut caches } else { &mut by_node[placed.node] };
                    list.push(Candidate { placed, job, place });
                }
            }
        }
        let mut there = There::new(problem);
        let releases: Vec<Option<i64>> =
            problem.jobs.iter().map(|work| Some(work.release(problem.input.now))).collect();
        caches.sort_unstable_by_key(Candidate::order);
        self.keep_in_order(&caches, &releases, &mut there);
        let earliest: Vec<Option<i64>> =
            (0..problem.jobs.len()).map(|job| self.earliest_frame(job)).collect();
        for of_node in &mut by_node {
            of_node.sort_unstable_by_key(Candidate::order);
        }
        self.keep_in_order(by_node.iter().flatten(), &earliest, &mut there);
        let of_class = |members: &Vec<usize>| Pool::new(problem, members, &self.lanes);
        self.pools = problem.classes.iter().map(of_class).collect();
        self.drop_partial_frames();
    }

    /// Keeps those that come no earlier than their jobs allow, in time that is still free.
    fn keep_in_order<'k>(
        &mut self,
        all: impl IntoIterator<Item = &'k Candidate>,
        earliest: &[Option<i64>],
        there: &mut There,
    ) {
        for &Candidate { placed, job, place } in all {
            let Placed { node, start, end, task } = placed;
            if earliest[job].is_some_and(|earliest| earliest <= start)
                && self.lanes[node].is_free(start, end)
                && there.is_new(job, place, task)
            {
                // The pools follow when all are there.
                self.lanes[node].book(self.problem.nodes[node], start, end);
                self.placed[job].push(placed);
                self.kept[job] += 1;
            }
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
            partial.into_iter().for_each(|placed| self.vacate(&placed));
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
        if task.is_shared_cache() {
            return Some(self.problem.jobs[job].release(self.problem.input.now));
        }
        self.earliest_frame(job)
    }

    fn earliest_frame(&self, job: usize) -> Option<i64> {
        let work = &self.problem.jobs[job];
        let release = work.release(self.problem.input.now);
        if work.shared_cache.is_none() {
            return Some(release);
        }
        if self.misses_shared_cache(job) {
            return None;
        }
        let cache_parts = self.placed[job].iter().take_while(|placed| placed.task.is_shared_cache());
        cache_parts.map(|part| part.end.max(release)).max()
    }

    pub fn book(&mut self, job: usize, placed: Placed) {
        self.occupy(&placed);
        self.placed[job].push(placed);
    }

    /// See [`crate::places::Search::for_others`]. Outside of what the programme gave a job, others' time
    /// counts more than they would pay: it then goes to those that have no other.
    pub fn for_others(&self) -> i128 {
        if self.is_selfless { FOR_OTHERS } else { 0 }
    }

    /// Moves a placed task.
    pub fn relocate(&mut self, job: usize, index: usize, to: Placed) {
        let from = std::mem::replace(&mut self.placed[job][index], to);
        self.vacate(&from);
        self.occupy(&to);
    }

    /// Takes the time of a task on its node, and nothing else.
    pub fn occupy(&mut self, placed: &Placed) {
        let &Placed { node: index, start, end, .. } = placed;
        let (node, lane) = (self.problem.nodes[index], &mut self.lanes[index]);
        let pool = &mut self.pools[self.problem.class_of[index]];
        pool.leave(index, node, lane);
        if let Some(gap) = lane.gap(start) {
            pool.split(index, gap, (start, end));
        }
        lane.book(node, start, end);
        pool.join(index, node, lane);
    }

    /// Gives the time of a task back.
    pub fn vacate(&mut self, placed: &Placed) {
        let &Placed { node: index, start, end, .. } = placed;
        let (node, lane) = (self.problem.nodes[index], &mut self.lanes[index]);
        let pool = &mut self.pools[self.problem.class_of[index]];
        pool.leave(index, node, lane);
        pool.close(index, lane.room_without(start, end), (start, end));
        lane.unbook(node, start, end);
        pool.join(index, node, lane);
    }

    pub fn unbook(&mut self, job: usize, placed: Placed) {
        self.vacate(&placed);
        self.placed[job].retain(|other| *other != placed);
    }

    /// Removes these places of the job.
    pub fn unbook_all(&mut self, job: usize, places: &[Placed]) {
        places.iter().for_each(|placed| self.vacate(placed));
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

    /// Gives the job the places that it had.
    pub fn restore(&mut self, job: usize, before: Vec<Placed>) {
        let now = std::mem::take(&mut self.placed[job]);
        let had: HashSet<&Placed> = before.iter().collect();
        let has: HashSet<&Placed> = now.iter().collect();
        now.iter().filter(|placed| !had.contains(placed)).for_each(|placed| self.vacate(placed));
        before.iter().filter(|placed| !has.contains(placed)).for_each(|placed| self.occupy(placed));
        self.placed[job] = before;
    }

    /// Removes all but the first `count` placed tasks of the job.
    pub fn unbook_after(&mut self, job: usize, count: usize) {
        let count = count.min(self.placed[job].len());
        for last in self.placed[job].split_off(count).into_iter().rev() {
            self.vacate(&last);
        }
    }

    pub fn cost(&self) -> i64 {
        (0..self.lanes.len()).fold(0i64, |sum, node| sum.saturating_add(self.cost_of(node)))
    }

    /// The cost of a node's rentals.
    pub fn cost_of(&self, node: usize) -> i64 {
        let rentals = self.lanes[node].rentals(self.problem.nodes[node]);
        rentals.iter().fold(0i64, |sum, rental| sum.saturating_add(rental.cost))
    }

    pub fn finish(&self, job: usize) -> i64 {
        let release = self.problem.jobs[job].release(self.problem.input.now);
        self.placed[job].iter().map(|placed| placed.end).max().unwrap_or(release)
    }

    /// Numbers of the job's frames without a place.
    pub fn missing(&self, job: usize) -> Vec<i64> {
        let work = &self.problem.jobs[job];
        let mut there = vec![false; work.frames.len()];
        let numbers = self.placed[job].iter().filter_map(|placed| placed.task.frame());
        numbers.filter_map(|number| work.place(number)).for_each(|place| there[place] = true);
        let all = work.frames.iter().zip(there);
        let mut missing: Vec<i64> = all.filter(|(_, there)| !there).map(|(frame, _)| frame.number).collect();
        missing.sort_unstable();
        missing
    }

    /// Tasks of the shared cache without a place.
    pub fn missing_cache_parts(&self, job: usize) -> Vec<Task> {
        let all = self.problem.jobs[job].job.shared_cache.into_iter().flat_map(SharedCache::tasks);
        let there = || self.placed[job].iter().take_while(|placed| placed.task.is_shared_cache());
        all.filter(|&task| !there().any(|placed| placed.task == task)).collect()
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

/// A booking that is kept if its time is free.
#[derive(Clone, Copy)]
struct Candidate {
    placed: Placed,
    job: usize,
    /// See [`crate::problem::Work::place_of`].
    place: usize,
}

impl Candidate {
    fn order(&self) -> (usize, i64, usize, Task, i64) {
        let Placed { node, start, end, task } = self.placed;
        (node, start, self.job, task, end)
    }
}

/// Tasks that have been kept.
struct There {
    /// By job and frame, and last its shared cache: the number of its parts, if there is any. 0 stands for a
    /// whole.
    divided: Vec<Vec<Option<u32>>>,
    parts: HashSet<(usize, Task)>,
}

impl There {
    fn new(problem: &Problem) -> Self {
        let divided = problem.jobs.iter().map(|work| vec![None; work.frames.len() + 1]).collect();
        There { divided, parts: HashSet::new() }
    }

    /// Whether the job has neither this task nor one that excludes it. If so, the job has it from now on. For
    /// the place, see [`crate::problem::Work::place_of`].
    fn is_new(&mut self, job: usize, place: usize, task: Task) -> bool {
        let divided = &mut self.divided[job][place];
        match task {
            Task::Part { parts, .. } | Task::SharedCachePart { parts, .. } => {
                *divided.get_or_insert(parts) == parts && self.parts.insert((job, task))
            }
            Task::Frame(_) | Task::SharedCache => divided.replace(0).is_none(),
        }
    }
}
