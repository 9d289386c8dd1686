//! Cheaper places for frames that are in time.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use crate::exchange::{InVain, exchange};
use crate::lane::Prefer;
use crate::model::Task;
use crate::parts::divide_dear;
use crate::places::Search;
use crate::state::{Placed, State};

/// A round is the last if it saves less than one part in this many.
const LEAST_GAIN: i64 = 2000;
/// The most frames that are tried in parts to make them cheaper.
const MOST_DIVIDED: usize = 300;
/// After every so many frames of a job that find no cheaper place, one more of those that are like them is
/// left out between two that are tried.
const SKIPPED: u32 = 4;

/// Makes a plan cheaper, in at most `rounds` rounds. Each round closes gaps, moves single frames to cheaper
/// places, exchanges frames, and divides dear ones; each of these makes room for the next.
///
/// Frames of jobs without a deadline only move to earlier times on their nodes: those jobs were promised to
/// be early, not cheap.
pub(crate) fn improve(state: &mut State, rounds: usize) {
    cheapen(state);
    let mut in_vain = InVain::new();
    let mut trials = MOST_DIVIDED;
    for _ in 0..rounds {
        let before = state.cost();
        close_ranks(state);
        cheapen(state);
        exchange(state, &mut in_vain);
        divide_dear(state, &mut trials);
        if before.saturating_sub(state.cost()) < before / LEAST_GAIN {
            break;
        }
    }
}

/// Frames of a job in one class that found no cheaper place, one after the other.
#[derive(Clone, Copy, Debug, Default)]
struct Streak {
    failed: u32,
    /// So many like them are not tried.
    left_out: u32,
}

/// Moves single frames, and single parts of frames, of jobs with a deadline to cheaper places in time.
fn cheapen(state: &mut State) {
    let problem = state.problem;
    // By the most that each frame could save, largest first.
    let mut candidates: Vec<(Reverse<i64>, usize, Placed, usize)> = Vec::new();
    for (job, work) in problem.jobs.iter().enumerate() {
        if work.job.deadline.is_none_or(|deadline| state.finish(job) > deadline) {
            continue;
        }
        for (index, &placed) in state.placed[job].iter().enumerate().skip(state.kept[job]) {
            let Some(of_task) = work.work_of(placed.task) else { continue };
            let cheapest = work
                .classes
                .iter()
                .filter_map(|&class| {
                    let node = problem.representative(class);
                    Some(node.price(node.duration(of_task, work.job.class)?, false))
                })
                .min();
            let node = problem.nodes[placed.node];
            let saved = state.lanes[placed.node].saved_without(node, placed.start, placed.end);
            let least = if node.is_plainly_billed() { cheapest.unwrap_or(0) } else { 0 };
            if saved > least {
                candidates.push((Reverse(saved - least), job, placed, index));
            }
        }
    }
    candidates
        .sort_unstable_by_key(|&(gain, job, placed, _)| (gain, job, placed.start, placed.node, placed.task));
    let mut streaks: BTreeMap<(usize, usize), Streak> = BTreeMap::new();
    for (_, job, placed, index) in candidates {
        let streak = streaks.entry((job, problem.class_of[placed.node])).or_default();
        if streak.left_out > 0 {
            streak.left_out -= 1;
        } else if cheapen_frame(state, job, index) {
            *streak = Streak::default();
        } else {
            streak.failed += 1;
            streak.left_out = streak.failed / SKIPPED;
        }
    }
}

/// Returns whether there is a cheaper place.
fn cheapen_frame(state: &mut State, job: usize, index: usize) -> bool {
    let problem = state.problem;
    let placed = state.placed[job][index];
    let work = &problem.jobs[job];
    let Some(of_task) = work.work_of(placed.task) else { return false };
    let node = problem.nodes[placed.node];
    let saved = state.lanes[placed.node].saved_without(node, placed.start, placed.end);
    let cheaper: Vec<usize> = work
        .classes
        .iter()
        .copied()
        .filter(|&class| {
            let node = problem.representative(class);
            let price = node.duration(of_task, work.job.class).map(|duration| node.price(duration, false));
            // On nodes billed in steps, a frame may fit into time that is already paid for.
            price.is_some_and(|price| price < saved || !node.is_plainly_billed())
        })
        .collect();
    let Some(release) = state.earliest(job, placed.task) else { return false };
    let search = Search {
        class_of_work: work.job.class,
        work: of_task,
        release,
        latest_end: work.job.deadline.unwrap_or(i64::MAX),
        classes: &cheaper,
        prefer: Prefer::Cheap,
        below: saved,
        except: Some(placed.node),
        for_others: 0,
    };
    let Some((node, fit)) = state.find(&search) else { return false };
    state.relocate(job, index, Placed { node, start: fit.start, end: fit.end, task: placed.task });
    true
}

/// Moves frames on plainly billed nodes to an earlier time just before them, so that free time lies in fewer,
/// longer gaps.
fn close_ranks(state: &mut State) {
    let problem = state.problem;
    let mut by_node: Vec<Vec<(i64, usize, Task, usize)>> = vec![Vec::new(); problem.nodes.len()];
    for job in 0..problem.jobs.len() {
        for (index, placed) in state.placed[job].iter().enumerate().skip(state.kept[job]) {
            if !placed.task.is_shared_cache() && problem.nodes[placed.node].is_plainly_billed() {
                by_node[placed.node].push((placed.start, job, placed.task, index));
            }
        }
    }
    for pieces in &mut by_node {
        pieces.sort_unstable();
        for &(start, job, _, index) in pieces.iter() {
            let placed = state.placed[job][index];
            let Some(earliest) = state.earliest(job, placed.task) else { continue };
            let (from, _) = state.lanes[placed.node].room_without(start, placed.end);
            let by = start - from.max(earliest);
            if by <= 0 {
                continue;
            }
            let moved = Placed { start: start - by, end: placed.end - by, ..placed };
            state.relocate(job, index, moved);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::close_ranks;
    use crate::admission::Admission;
    use crate::model::{Confidence, Frame, Input, Interval, Job, Node, Task, WorkTotal};
    use crate::problem::Problem;
    use crate::state::{Placed, State};

    #[test]
    fn gaps_are_closed_up_but_for_what_is_kept_and_what_is_not_released() {
        let node =
            Node { id: 1, speed: 1, calendar: vec![Interval { start: 0, end: None }], ..Node::default() };
        let job = |id: u64, release: i64| Job {
            id,
            release: release * 1_000_000,
            deadline: Some(100_000_000),
            confidence: Confidence::P50,
            total: WorkTotal { p50: 10, p80: 10, p95: 10 },
            frames: vec![Frame { number: 0, work: 10, ..Frame::default() }],
            ..Job::default()
        };
        let input =
            Input { nodes: vec![node], jobs: vec![job(0, 0), job(1, 0), job(2, 45)], ..Input::default() };
        let problem = Problem::new(&input);
        let admission = Admission::none(&problem);
        let mut state = State::new(&problem, &admission);
        for (job, start) in [(0, 5), (1, 30), (2, 60)] {
            let (start, end) = (start * 1_000_000, (start + 10) * 1_000_000);
            state.book(job, Placed { node: 0, start, end, task: Task::Frame(0) });
        }
        state.kept[0] = 1;
        close_ranks(&mut state);
        let starts: Vec<i64> = state.placed.iter().map(|placed| placed[0].start / 1_000_000).collect();
        assert_eq!(starts, [5, 15, 45]);
    }
}
