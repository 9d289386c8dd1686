//! Exchanges: an expensive frame takes the place of one that has a cheap alternative.
//!
//! List scheduling goes by deadlines. So a job that fits on many nodes may hold the few that a later job
//! needs, and the later job has to rent. Moving one frame saves nothing then, but moving two can.
//!
//! An exchange lifts a cheap frame out, puts an expensive one into its place, and places the lifted one anew.
//! That may push out a third frame (an ejection chain, Glover 1996). The exchange stays if it saves money and
//! all of them are in time.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use crate::lane::{Prefer, Wanted};
use crate::model::{Task, price_of};
use crate::places::Search;
use crate::problem::Work;
use crate::state::{Placed, State};

/// The most searches for another place in one call. They dominate its run time.
const MOST_TRIALS: usize = 3000;
/// The most places tried for one frame.
const MOST_PLACES: usize = 4;
/// The most frames of a class of nodes and slot that are looked at for this.
const MOST_LOOKS: usize = 32;
/// The most further frames that a chain may push out.
const LONGEST_CHAIN: usize = 1;

/// How many exchanges of a frame, or a part of one, failed, by job and task.
pub(crate) type InVain = BTreeMap<(usize, Task), u32>;

/// Exchanges frames of jobs with a deadline where that saves money, the largest possible saving first.
///
/// Each failed attempt halves a frame's rank. Otherwise a few hundred frames that cannot be improved would
/// use up all trials in every round.
pub(crate) fn exchange(state: &mut State, in_vain: &mut InVain) {
    let mut board = Board::new(state);
    for piece in dear(state, &board, in_vain) {
        if board.trials == 0 {
            return;
        }
        // An earlier exchange may have moved it.
        if board.at(piece.placed.node, piece.placed.start) == Some(piece)
            && !improve(state, &mut board, piece)
        {
            *in_vain.entry(piece.name()).or_default() += 1;
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Piece {
    job: usize,
    /// Where it is in [`State::placed`] of its job.
    index: usize,
    work: u64,
    placed: Placed,
}

/// What moving a frame would save, most first; its node, start, end and job.
type Gain = (Reverse<i128>, usize, i64, i64, usize);

/// All frames that may be moved.
struct Board {
    /// By node and start.
    pieces: BTreeMap<(usize, i64), Piece>,
    /// By class of nodes and slot of the programme: those that could go elsewhere. What is saved is the
    /// cost of their place, less that of the best free alternative.
    gains: BTreeMap<(usize, usize), BTreeSet<Gain>>,
    /// See [`elsewhere`].
    elsewhere: Vec<Option<(i64, u64)>>,
    trials: usize,
}

impl Board {
    fn new(state: &State) -> Self {
        let problem = state.problem;
        let mut board = Board {
            pieces: BTreeMap::new(),
            gains: BTreeMap::new(),
            elsewhere: elsewhere(state),
            trials: MOST_TRIALS,
        };
        for (job, work) in problem.jobs.iter().enumerate() {
            if work.job.deadline.is_none_or(|deadline| state.finish(job) > deadline) {
                continue;
            }
            for (index, &placed) in state.placed[job].iter().enumerate().skip(state.kept[job]) {
                if let Some(work) = work.work_of(placed.task) {
                    board.put(state, Piece { job, index, work, placed });
                }
            }
        }
        board
    }

    fn put(&mut self, state: &State, piece: Piece) {
        if let Some(gain) = self.gain(state, &piece) {
            self.gains.entry(place(state, &piece)).or_default().insert(gain);
        }
        self.pieces.insert((piece.placed.node, piece.placed.start), piece);
    }

    fn take(&mut self, state: &State, piece: Piece) {
        if let Some(gain) = self.gain(state, &piece)
            && let Some(gains) = self.gains.get_mut(&place(state, &piece))
        {
            gains.remove(&gain);
        }
        self.pieces.remove(&(piece.placed.node, piece.placed.start));
    }

    fn gain(&self, state: &State, piece: &Piece) -> Option<Gain> {
        let (cost, work) = self.elsewhere[piece.job]?;
        let Placed { node, start, end, .. } = piece.placed;
        let price = state.problem.nodes[node].price_per_hour;
        let is = i128::from(price_of(price, end.saturating_sub(start)));
        // Usually 64 bits are enough, and their division is several times as fast.
        let elsewhere = match u64::try_from(cost).ok().and_then(|cost| cost.checked_mul(piece.work)) {
            Some(product) => i128::from(product / work),
            None => i128::from(cost).saturating_mul(i128::from(piece.work)) / i128::from(work),
        };
        Some((Reverse(is - elsewhere), node, start, end, piece.job))
    }

    fn at(&self, node: usize, start: i64) -> Option<Piece> {
        self.pieces.get(&(node, start)).copied()
    }
}

/// Class of nodes and slot in which a frame begins.
fn place(state: &State, piece: &Piece) -> (usize, usize) {
    (state.problem.class_of[piece.placed.node], state.admission.slot(piece.placed.start))
}

/// By job: cost of its middle frame in the best place that is free now, and that frame's work. `None` without
/// such a place.
fn elsewhere(state: &State) -> Vec<Option<(i64, u64)>> {
    let of_job = |(job, work): (usize, &Work)| {
        let frame = work.frames.get(work.frames.len() / 2)?;
        let plain = plain_below(state, job, frame.work, i64::MAX);
        let search = search(state, job, Task::Frame(frame.number), frame.work, &plain)?;
        let (_, fit) = state.find(&search)?;
        Some((fit.added_cost, frame.work.max(1)))
    };
    state.problem.jobs.iter().enumerate().map(of_job).collect()
}

/// Classes of plainly billed nodes that could render this work for less than `below`.
fn plain_below(state: &State, job: usize, work: u64, below: i64) -> Vec<usize> {
    let problem = state.problem;
    let asked = &problem.jobs[job];
    let is_cheap = |&class: &usize| {
        let node = problem.representative(class);
        let price = node.duration(work, asked.job.class).map(|time| price_of(node.price_per_hour, time));
        node.is_plainly_billed() && price.is_some_and(|price| price < below)
    };
    asked.classes.iter().copied().filter(is_cheap).collect()
}

fn search<'s>(state: &State, job: usize, task: Task, work: u64, classes: &'s [usize]) -> Option<Search<'s>> {
    let asked: &Work = &state.problem.jobs[job];
    Some(Search {
        class_of_work: asked.job.class,
        work,
        release: state.earliest(job, task)?,
        latest_end: asked.job.deadline?,
        classes,
        prefer: Prefer::Cheap,
        below: i64::MAX,
        except: None,
        for_others: 0,
    })
}

impl Piece {
    fn name(&self) -> (usize, Task) {
        (self.job, self.placed.task)
    }
}

/// Frames that could save money, the largest possible saving first.
fn dear(state: &State, board: &Board, in_vain: &InVain) -> Vec<Piece> {
    let problem = state.problem;
    let mut found = Vec::new();
    for &piece in board.pieces.values() {
        let work = &problem.jobs[piece.job];
        let price = |&class: &usize| {
            let node = problem.representative(class);
            Some(node.price(node.duration(piece.work, work.job.class)?, false))
        };
        let cheapest = work.classes.iter().filter_map(price).min().unwrap_or(0);
        let saved = saved(state, piece.placed).saturating_sub(cheapest);
        if saved > 0 {
            let tried = in_vain.get(&piece.name()).map_or(0, |&times| times.min(i64::BITS - 1));
            found.push((Reverse(saved >> tried), piece));
        }
    }
    found.sort_by_key(|(saved, piece)| (*saved, piece.job, piece.placed.start, piece.placed.node));
    found.into_iter().map(|(_, piece)| piece).collect()
}

fn saved(state: &State, placed: Placed) -> i64 {
    state.lanes[placed.node].saved_without(state.problem.nodes[placed.node], placed.start, placed.end)
}

/// Moves a frame to a cheaper place. Returns whether there is one.
fn improve(state: &mut State, board: &mut Board, piece: Piece) -> bool {
    let before = saved(state, piece.placed);
    lift(state, board, piece);
    let is_settled = settle(state, board, piece, before, LONGEST_CHAIN).is_some();
    if !is_settled {
        set(state, board, piece);
    }
    is_settled
}

fn lift(state: &mut State, board: &mut Board, piece: Piece) {
    board.take(state, piece);
    state.vacate(&piece.placed);
}

fn set(state: &mut State, board: &mut Board, piece: Piece) {
    state.occupy(&piece.placed);
    state.placed[piece.job][piece.index] = piece.placed;
    board.put(state, piece);
}

/// Places a lifted frame for less than `below`, with all frames that it pushes out. Returns the cost. Without
/// such a place, nothing changes.
fn settle(state: &mut State, board: &mut Board, piece: Piece, below: i64, chain: usize) -> Option<i64> {
    let classes = plain_below(state, piece.job, piece.work, below);
    let search = search(state, piece.job, piece.placed.task, piece.work, &classes)?;
    board.trials = board.trials.saturating_sub(1);
    let free = state.find(&search).filter(|(_, fit)| fit.added_cost < below);
    let limit = free.map_or(below, |(_, fit)| fit.added_cost);
    if chain > 0 {
        for other in in_the_way(state, board, piece, &search, limit) {
            if board.trials == 0 {
                break;
            }
            if let Some(cost) = push_out(state, board, piece, other, limit, chain) {
                return Some(cost);
            }
        }
    }
    let (node, fit) = free?;
    let placed = Placed { node, start: fit.start, end: fit.end, task: piece.placed.task };
    set(state, board, Piece { placed, ..piece });
    Some(fit.added_cost)
}

/// The best frames to push out: this one fits into their place, and the money saved may pay for their new
/// place.
fn in_the_way(state: &State, board: &Board, piece: Piece, search: &Search, below: i64) -> Vec<Piece> {
    let problem = state.problem;
    let mut best: Vec<Gain> = Vec::new();
    for &class in search.classes {
        let of_class = problem.representative(class);
        let Some(duration) = of_class.duration(piece.work, search.class_of_work) else { continue };
        let left = i128::from(below) - i128::from(price_of(of_class.price_per_hour, duration));
        if left <= 0 {
            continue;
        }
        let slots = [search.release, search.latest_end].map(|instant| (class, state.admission.slot(instant)));
        for (_, gains) in board.gains.range(slots[0]..=slots[1]) {
            for &(Reverse(gain), node, start, end, job) in gains.iter().take(MOST_LOOKS) {
                problem.looks.add(1);
                let entry = (Reverse(gain + left), node, start, end, job);
                let is_worse = best.len() == MOST_PLACES && best.last().is_some_and(|last| entry > *last);
                if gain + left <= 0 || is_worse {
                    break;
                }
                let (from, until) = state.lanes[node].room_without(start, end);
                let room = until.min(search.latest_end).saturating_sub(from.max(search.release));
                if job != piece.job && room >= duration {
                    best.insert(best.partition_point(|better| *better < entry), entry);
                    best.truncate(MOST_PLACES);
                }
            }
        }
    }
    best.into_iter().filter_map(|(_, node, start, ..)| board.at(node, start)).collect()
}

/// Puts a lifted frame into the place of another and places that one elsewhere, for less than `below`
/// together. Otherwise nothing changes.
fn push_out(
    state: &mut State,
    board: &mut Board,
    piece: Piece,
    other: Piece,
    below: i64,
    chain: usize,
) -> Option<i64> {
    let problem = state.problem;
    let node = other.placed.node;
    let place = problem.nodes[node];
    let (from, until) = state.lanes[node].room_without(other.placed.start, other.placed.end);
    let wanted = {
        let search = search(state, piece.job, piece.placed.task, piece.work, &[])?;
        Wanted {
            release: search.release.max(from),
            latest_end: search.latest_end.min(until),
            duration: place.duration(piece.work, search.class_of_work)?,
        }
    };
    let back = saved(state, other.placed);
    lift(state, board, other);
    if let Some((start, end)) = state.lanes[node].first(&wanted) {
        let placed = Placed { node, start, end, task: piece.placed.task };
        let own = state.lanes[node].added_cost(place, start, end).saturating_sub(back);
        set(state, board, Piece { placed, ..piece });
        if let Some(rest) = settle(state, board, other, below.saturating_sub(own), chain - 1) {
            return Some(own.saturating_add(rest));
        }
        lift(state, board, Piece { placed, ..piece });
    }
    set(state, board, other);
    None
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use super::{Board, InVain, dear, exchange};
    use crate::admission::Admission;
    use crate::model::{Confidence, Frame, Input, Interval, Job, Node, Task, WorkTotal};
    use crate::problem::Problem;
    use crate::state::{Placed, State};

    const HOUR: i64 = 3_600_000_000;

    /// The nodes of two jobs after exchanges. At first the small job is on the cheap node and the large one
    /// on the expensive node. A third node with this price fits the small job.
    fn nodes_after(price: i64, deadline: i64) -> Vec<u64> {
        // Small nodes cannot do the large jobs' class of work.
        let node = |id: u64, large: u64, price: i64| Node {
            id,
            speed: 1,
            speeds: Arc::new(BTreeMap::from([(1, large)])),
            price_per_hour: price,
            calendar: vec![Interval { start: 0, end: Some(2 * HOUR) }],
            ..Node::default()
        };
        let job = |id: u64, class: u32, deadline: i64| Job {
            id,
            class,
            deadline: Some(deadline),
            confidence: Confidence::P50,
            total: WorkTotal { p50: 7200, p80: 7200, p95: 7200 },
            frames: vec![Frame { number: 0, work: 7200, ..Frame::default() }],
            ..Job::default()
        };
        let input = Input {
            nodes: vec![node(1, 1, 1000), node(2, 0, price), node(3, 1, 9000)],
            jobs: vec![job(0, 0, 2 * HOUR), job(1, 1, deadline)],
            ..Input::default()
        };
        let problem = Problem::new(&input);
        let admission = Admission::none(&problem);
        let mut state = State::new(&problem, &admission);
        for (job, node) in [(0, 0), (1, 2)] {
            state.book(job, Placed { node, start: 0, end: 2 * HOUR, task: Task::Frame(0) });
        }
        exchange(&mut state, &mut InVain::new());
        state.placed.iter().map(|placed| problem.nodes[placed[0].node].id).collect()
    }

    #[test]
    fn the_large_job_gets_the_cheap_node_if_the_small_one_can_go_elsewhere_for_less() {
        assert_eq!(nodes_after(5000, 2 * HOUR), [2, 1]);
        assert_eq!(nodes_after(8999, 2 * HOUR), [2, 1]);
    }

    #[test]
    fn nothing_changes_places_where_that_saves_nothing_or_a_job_is_late() {
        assert_eq!(nodes_after(9000, 2 * HOUR), [1, 3]);
        assert_eq!(nodes_after(5000, HOUR), [1, 3]);
    }

    #[test]
    fn a_frame_that_was_tried_in_vain_lets_others_go_first_that_could_save_more_than_half_as_much() {
        let node = |id: u64, price: i64| Node {
            id,
            speed: 1,
            price_per_hour: price,
            calendar: vec![Interval { start: 0, end: Some(9 * HOUR) }],
            ..Node::default()
        };
        let frame = |number: i64, work: u64| Frame { number, work, ..Frame::default() };
        let job = Job {
            id: 1,
            deadline: Some(9 * HOUR),
            confidence: Confidence::P50,
            total: WorkTotal { p50: 18_000, p80: 18_000, p95: 18_000 },
            frames: vec![frame(1, 3600), frame(2, 10_800), frame(3, 3600)],
            ..Job::default()
        };
        let input = Input { nodes: vec![node(1, 1000), node(2, 9000)], jobs: vec![job], ..Input::default() };
        let problem = Problem::new(&input);
        let admission = Admission::none(&problem);
        let mut state = State::new(&problem, &admission);
        for (number, start, end) in [(1, 0, 1), (2, 1, 4), (3, 4, 5)] {
            let (start, end) = (start * HOUR, end * HOUR);
            state.book(0, Placed { node: 1, start, end, task: Task::Frame(number) });
        }
        let board = Board::new(&state);
        let order = |in_vain: &InVain| -> Vec<Task> {
            dear(&state, &board, in_vain).iter().map(|piece| piece.placed.task).collect()
        };
        let frames = |numbers: [i64; 3]| numbers.map(Task::Frame);
        assert_eq!(order(&InVain::new()), frames([2, 1, 3]));
        let tried = |times: u32| InVain::from([((0, Task::Frame(2)), times)]);
        assert_eq!(order(&tried(1)), frames([2, 1, 3]), "half of three times as much");
        assert_eq!(order(&tried(2)), frames([1, 3, 2]));
        assert_eq!(order(&tried(u32::MAX)), frames([1, 3, 2]));
    }
}
