//! Small farms with few frames: every assignment is tried.
//!
//! For one node and a set of frames, the order that ends first is found by the dynamic programme over sets of Held and Karp
//! (1962): the earliest end of a set is that of one of its frames after the rest. A set that ends as early as it can
//! leaves every later frame at least as much time, so a set that can be done in time is found to be. Then the sets are dealt
//! out to the nodes, each set at what its rentals cost. Where nodes are billed plainly that is the optimum.

use crate::lane::{Lane, Prefer, Unwanted, Wanted};
use crate::model::Task;
use crate::problem::Problem;
use crate::state::{Placed, State};

/// Sets of this many frames, at most.
const MOST_FRAMES: usize = 9;
const MOST_NODES: usize = 5;
/// Some 140,000 years: later than this counts as never.
const MOST_LATE: i64 = 1 << 62;

/// The cheapest plan that keeps all deadlines, if the problem is small, all its jobs have deadlines, and
/// nothing couples the nodes. If there is no such plan, the one in which the jobs that `found` has late are late by no more than they have to be, while
/// the others stay in time. None if the problem is not like that.
pub(crate) fn search<'p, 'a>(
    problem: &'p Problem<'a>,
    start: &State<'p, 'a>,
    found: &State<'p, 'a>,
) -> Option<State<'p, 'a>> {
    let frames = frames(problem, start)?;
    let deadlines = |late: i64| -> Vec<i64> {
        let deadline = |job: usize| problem.jobs[job].job.deadline.unwrap_or(i64::MAX);
        let by = |job: usize| if found.is_kept(job) { 0 } else { late };
        (0..problem.jobs.len()).map(|job| deadline(job).saturating_add(by(job))).collect()
    };
    let tables = |late: i64| -> Vec<Table> {
        let deadlines = deadlines(late);
        (0..problem.nodes.len()).map(|node| Table::new(problem, start, node, &frames, &deadlines)).collect()
    };
    let is_possible = |late: i64| deal(&tables(late), frames.len()).is_some();
    let mut late = 0;
    if !is_possible(0) {
        // The least lateness, by halving between what cannot be and what can.
        let (mut low, mut high) = (0i64, latest(found));
        if !is_possible(high) {
            return None;
        }
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            if is_possible(middle) { high = middle } else { low = middle }
        }
        late = high;
    }
    let mut tables = tables(late);
    for (node, table) in tables.iter_mut().enumerate() {
        table.price(problem, start, node);
    }
    let chosen = deal(&tables, frames.len())?;
    let mut state = start.clone();
    for (node, (table, set)) in tables.iter().zip(chosen).enumerate() {
        for (frame, start, end) in table.order(set) {
            let (job, index) = frames[frame];
            let number = problem.jobs[job].frames[index].number;
            state.book(job, Placed { node, start, end, task: Task::Frame(number) });
        }
    }
    Some(state)
}

/// By how much the latest job is late; very much if something has no place.
fn latest(found: &State) -> i64 {
    let late = |job: usize| {
        let deadline = found.problem.jobs[job].job.deadline.unwrap_or(i64::MAX);
        if found.missing_tasks(job) > 0 { MOST_LATE } else { found.finish(job).saturating_sub(deadline) }
    };
    (0..found.problem.jobs.len()).map(late).max().unwrap_or(0).clamp(1, MOST_LATE)
}

/// Job and place of every frame, if the problem is one that is tried out.
fn frames(problem: &Problem, start: &State) -> Option<Vec<(usize, usize)>> {
    let is_simple = problem.jobs.iter().all(|work| {
        let job = work.job;
        job.deadline.is_some() && job.seed.is_none() && job.uses.is_empty() && job.tiles < 2
    });
    let nothing_kept = start.kept.iter().all(|&kept| kept == 0);
    let frames: Vec<(usize, usize)> = problem
        .jobs
        .iter()
        .enumerate()
        .flat_map(|(job, work)| (0..work.frames.len()).map(move |frame| (job, frame)))
        .collect();
    if !is_simple || !nothing_kept || frames.len() > MOST_FRAMES || problem.nodes.len() > MOST_NODES {
        return None;
    }
    Some(frames)
}

/// One node: by set of frames, how early they can be done by their deadlines, and what that costs.
struct Table {
    /// Last frame, its start and its end, of the order that ends first.
    best: Vec<Option<(usize, i64, i64)>>,
    /// Nothing at first, for sets that can be done.
    cost: Vec<Option<i64>>,
}

impl Table {
    fn new(
        problem: &Problem,
        state: &State,
        node: usize,
        frames: &[(usize, usize)],
        deadlines: &[i64],
    ) -> Self {
        let place = problem.nodes[node];
        let sets = 1usize << frames.len();
        let mut table = Table { best: vec![None; sets], cost: vec![None; sets] };
        let empty: &Lane = &state.lanes[node];
        for set in 1..sets {
            for (last, &(job, frame)) in frames.iter().enumerate().filter(|(bit, _)| set >> bit & 1 == 1) {
                let rest = set & !(1 << last);
                let after = match (rest, table.best[rest]) {
                    (0, _) => i64::MIN,
                    (_, Some((_, _, end))) => end,
                    (_, None) => continue,
                };
                let work = &problem.jobs[job];
                let task = Task::Frame(work.frames[frame].number);
                let Some(duration) = work.duration(place, task) else { continue };
                let wanted = Wanted {
                    release: work.release(problem.input.now).max(after),
                    latest_end: deadlines[job],
                    duration,
                    uses: &[],
                };
                let Some(fit) = empty.fit(place, &wanted, &state.ledger, Prefer::Early, &Unwanted) else {
                    continue;
                };
                if table.best[set].is_none_or(|(_, _, end)| fit.end < end) {
                    table.best[set] = Some((last, fit.start, fit.end));
                }
            }
        }
        table.cost[0] = Some(0);
        for set in (1..sets).filter(|&set| table.best[set].is_some()) {
            table.cost[set] = Some(0);
        }
        table
    }

    /// Works out what the sets that can be done cost.
    fn price(&mut self, problem: &Problem, state: &State, node: usize) {
        let (place, empty) = (problem.nodes[node], &state.lanes[node]);
        for set in (1..self.cost.len()).filter(|&set| self.best[set].is_some()) {
            let mut lane = empty.clone();
            self.order(set).into_iter().for_each(|(_, start, end)| lane.book(place, start, end));
            let cost = lane.rentals(place).iter().fold(0i64, |sum, rental| sum.saturating_add(rental.cost));
            self.cost[set] = Some(cost);
        }
    }

    /// The frames of a set with their times.
    fn order(&self, mut set: usize) -> Vec<(usize, i64, i64)> {
        let mut order = Vec::new();
        while let Some((last, start, end)) = self.best[set] {
            order.push((last, start, end));
            set &= !(1 << last);
        }
        order
    }
}

/// The cheapest way to deal all frames out to the nodes: a set for each.
fn deal(tables: &[Table], frames: usize) -> Option<Vec<usize>> {
    let all = (1usize << frames) - 1;
    // Cost of a set on the nodes so far, and what of it the last of them has.
    let mut layers: Vec<Vec<Option<(i64, usize)>>> = Vec::with_capacity(tables.len());
    for table in tables {
        let mut layer: Vec<Option<(i64, usize)>> = vec![None; all + 1];
        for (set, cheapest) in layer.iter_mut().enumerate() {
            // All subsets, the empty one included.
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
