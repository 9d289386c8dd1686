//! Exact search for small farms: every assignment of frames to nodes.
//!
//! For one node and a set of frames, a dynamic programme over sets (Held and Karp 1962) finds the order that
//! ends first. The earliest end of a set is that of one of its frames after the rest. Ending a subset early
//! never hurts the frames after it, so the search finds every set that can be in time.
//!
//! Then each node gets a set, priced by its rentals. Where nodes are billed plainly, the result is the
//! optimum, as long as frames that may be divided are whole. Frames that must be divided count as their
//! parts.

use crate::lane::{Lane, Wanted};
use crate::model::Task;
use crate::problem::{FrameWork, Problem, Work};
use crate::score::broken;
use crate::state::{Placed, State};

/// Tables have an entry for every set of tasks.
const MOST_TASKS: usize = 9;
const MOST_NODES: usize = 5;
/// About 140,000 years in microseconds.
const MOST_LATE: i64 = 1 << 62;

/// The cheapest plan that keeps all deadlines. If none exists, a plan that breaks the least, with the least
/// lateness of the broken jobs.
///
/// `None` if the problem is too large, a job has no deadline, or a shared cache couples the nodes.
pub(crate) fn search<'p, 'a>(
    problem: &'p Problem<'a>,
    start: &State<'p, 'a>,
    found: &State<'p, 'a>,
) -> Option<State<'p, 'a>> {
    let tasks = tasks(problem, start)?;
    let tables = |kept: &[bool], late: i64| -> Vec<Table> {
        let latest = |(work, &kept): (&Work, &bool)| {
            work.job.deadline.unwrap_or(i64::MAX).saturating_add(if kept { 0 } else { late })
        };
        let latest: Vec<i64> = problem.jobs.iter().zip(kept).map(latest).collect();
        (0..problem.nodes.len()).map(|node| Table::new(problem, start, node, &tasks, &latest)).collect()
    };
    let is_possible = |kept: &[bool], late: i64| deal(&tables(kept, late), tasks.len()).is_some();
    let (mut kept, mut late) = (vec![true; problem.jobs.len()], 0);
    if !is_possible(&kept, 0) {
        kept = most_in_time(problem, found, |kept| is_possible(kept, MOST_LATE))?;
        // Bisect for the least lateness of the rest.
        let (mut low, mut high) = (0, MOST_LATE);
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            if is_possible(&kept, middle) { high = middle } else { low = middle }
        }
        late = high;
    }
    let mut tables = tables(&kept, late);
    for (node, table) in tables.iter_mut().enumerate() {
        table.price(problem, start, node);
    }
    let chosen = deal(&tables, tasks.len())?;
    let mut state = start.clone();
    for (node, (table, set)) in tables.iter().zip(chosen).enumerate() {
        for (index, start, end) in table.order(set) {
            let (job, task) = tasks[index];
            state.book(job, Placed { node, start, end, task });
        }
    }
    Some(state)
}

/// The jobs to keep in time if not all can be: a possible set that breaks the least, preferably that of
/// `found`. `None` if even the empty set is impossible.
fn most_in_time(
    problem: &Problem,
    found: &State,
    is_possible: impl Fn(&[bool]) -> bool,
) -> Option<Vec<bool>> {
    // A job with nothing left to do takes no time from others. So there are at most as many open jobs as
    // tasks.
    let (open, done): (Vec<usize>, Vec<usize>) =
        (0..problem.jobs.len()).partition(|&job| !problem.jobs[job].frames.is_empty());
    let of_set = |jobs: &[usize], set: usize| {
        let mut kept = vec![false; problem.jobs.len()];
        done.iter().for_each(|&job| kept[job] = true);
        (0..jobs.len()).filter(|bit| set >> bit & 1 == 1).for_each(|bit| kept[jobs[bit]] = true);
        kept
    };
    // A job that cannot be in time alone is in no possible set.
    let hopeful: Vec<usize> = open.iter().copied().filter(|&job| is_possible(&of_set(&[job], 1))).collect();
    let is_found = |kept: &[bool]| open.iter().all(|&job| kept[job] == found.is_kept(job));
    let mut sets: Vec<Vec<bool>> = (0..1usize << hopeful.len()).map(|set| of_set(&hopeful, set)).collect();
    sets.sort_by_cached_key(|kept| (broken(problem, |job| !kept[job]), !is_found(kept)));
    sets.into_iter().find(|kept| is_possible(kept))
}

/// Job and task of every frame: whole, or all parts that it must have. `None` if the problem is not suitable.
fn tasks(problem: &Problem, start: &State) -> Option<Vec<(usize, Task)>> {
    let is_simple = problem.jobs.iter().all(|work| {
        let job = work.job;
        job.deadline.is_some() && job.shared_cache.is_none()
    });
    let nothing_kept = start.kept.iter().all(|&kept| kept == 0);
    let frames = || problem.jobs.iter().flat_map(|work| &work.frames);
    let count = frames().fold(0usize, |sum, frame| sum.saturating_add(frame.division.fewest() as usize));
    if !is_simple || !nothing_kept || count > MOST_TASKS || problem.nodes.len() > MOST_NODES {
        return None;
    }
    let of_frame = |frame: &FrameWork| -> Vec<Task> {
        let number = frame.number;
        match frame.division.fewest() {
            1 => vec![Task::Frame(number)],
            parts => (0..parts).map(|part| Task::Part { frame: number, part, parts }).collect(),
        }
    };
    let jobs = problem.jobs.iter().enumerate();
    Some(
        jobs.flat_map(|(job, work)| work.frames.iter().flat_map(of_frame).map(move |task| (job, task)))
            .collect(),
    )
}

/// One node. By set of tasks: the order that ends first within the deadlines, and its cost.
struct Table {
    /// Last task, its start and its end.
    best: Vec<Option<(usize, i64, i64)>>,
    /// `None` if the set is impossible. Zero until [`Table::price`] computes it.
    cost: Vec<Option<i64>>,
}

impl Table {
    fn new(
        problem: &Problem,
        state: &State,
        node: usize,
        tasks: &[(usize, Task)],
        deadlines: &[i64],
    ) -> Self {
        let place = problem.nodes[node];
        let sets = 1usize << tasks.len();
        let mut table = Table { best: vec![None; sets], cost: vec![None; sets] };
        let empty: &Lane = &state.lanes[node];
        for set in 1..sets {
            for (last, &(job, task)) in tasks.iter().enumerate().filter(|(bit, _)| set >> bit & 1 == 1) {
                let rest = set & !(1 << last);
                let after = match (rest, table.best[rest]) {
                    (0, _) => i64::MIN,
                    (_, Some((_, _, end))) => end,
                    (_, None) => continue,
                };
                let work = &problem.jobs[job];
                let Some(duration) = work.duration(place, task) else { continue };
                let wanted = Wanted {
                    release: work.release(problem.input.now).max(after),
                    latest_end: deadlines[job],
                    duration,
                };
                let Some((start, end)) = empty.first(&wanted) else { continue };
                if table.best[set].is_none_or(|(_, _, least)| end < least) {
                    table.best[set] = Some((last, start, end));
                }
            }
        }
        table.cost[0] = Some(0);
        for set in (1..sets).filter(|&set| table.best[set].is_some()) {
            table.cost[set] = Some(0);
        }
        table
    }

    fn price(&mut self, problem: &Problem, state: &State, node: usize) {
        let (place, empty) = (problem.nodes[node], &state.lanes[node]);
        for set in (1..self.cost.len()).filter(|&set| self.best[set].is_some()) {
            let mut lane = empty.clone();
            self.order(set).into_iter().for_each(|(_, start, end)| lane.book(place, start, end));
            let cost = lane.rentals(place).iter().fold(0i64, |sum, rental| sum.saturating_add(rental.cost));
            self.cost[set] = Some(cost);
        }
    }

    fn order(&self, mut set: usize) -> Vec<(usize, i64, i64)> {
        let mut order = Vec::new();
        while let Some((last, start, end)) = self.best[set] {
            order.push((last, start, end));
            set &= !(1 << last);
        }
        order
    }
}

/// The cheapest way to give each node a set, so that all tasks are covered.
fn deal(tables: &[Table], tasks: usize) -> Option<Vec<usize>> {
    let all = (1usize << tasks) - 1;
    // By set: its cheapest cost on the nodes so far, and the last node's part of it.
    let mut layers: Vec<Vec<Option<(i64, usize)>>> = Vec::with_capacity(tables.len());
    for table in tables {
        let mut layer: Vec<Option<(i64, usize)>> = vec![None; all + 1];
        for (set, cheapest) in layer.iter_mut().enumerate() {
            let mut part = set;
            loop {
                let rest = match layers.last() {
                    None => (set == part).then_some(0),
                    Some(before) => before[set & !part].map(|(cost, _)| cost),
                };
                if let Some(cost) = table.cost[part].zip(rest).map(|(a, b)| a.saturating_add(b))
                    && cheapest.is_none_or(|(least, _)| cost < least)
                {
                    *cheapest = Some((cost, part));
                }
                if part == 0 {
                    break;
                }
                part = (part - 1) & set;
            }
        }
        layers.push(layer);
    }
    let mut set = all;
    let mut chosen = vec![0; tables.len()];
    for node in (0..tables.len()).rev() {
        let (_, part) = layers[node][set]?;
        chosen[node] = part;
        set &= !part;
    }
    (set == 0).then_some(chosen)
}
