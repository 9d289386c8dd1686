//! Cheaper places for frames that are in time.

use std::cmp::Reverse;

use crate::lane::Prefer;
use crate::model::Task;
use crate::state::{Placed, Search, State};

/// Rounds over all frames; the second finds what the first made room for.
const ROUNDS: usize = 2;

/// Moves frames of jobs with a deadline to where they save money and are still in time. Jobs without a deadline were
/// promised to be early, not cheap.
pub(crate) fn cheapen(state: &mut State) {
    for _ in 0..ROUNDS {
        if !cheapen_once(state) {
            break;
        }
    }
}

fn cheapen_once(state: &mut State) -> bool {
    let problem = state.problem;
    // What each frame could save at most, the most promising first.
    let mut candidates: Vec<(Reverse<i64>, usize, Placed)> = Vec::new();
    for (job, work) in problem.jobs.iter().enumerate() {
        if work.job.deadline.is_none_or(|deadline| state.finish(job) > deadline) {
            continue;
        }
        for &placed in state.placed[job].iter().skip(state.kept[job]) {
            let Task::Frame(number) = placed.task else { continue };
            let Some(frame) = work.frames.iter().find(|frame| frame.number == number) else { continue };
            let cheapest = work
                .classes
                .iter()
                .filter_map(|&class| {
                    let node = problem.representative(class);
                    Some(node.price(node.duration(frame.work, work.job.class)?, false))
                })
                .min();
            let node = problem.nodes[placed.node];
            let saved = state.lanes[placed.node].saved_without(node, placed.start, placed.end);
            let least = if node.is_plainly_billed() { cheapest.unwrap_or(0) } else { 0 };
            if saved > least {
                candidates.push((Reverse(saved - least), job, placed));
            }
        }
    }
    candidates
        .sort_unstable_by_key(|&(gain, job, placed)| (gain, job, placed.start, placed.node, placed.task));
    let mut moved = false;
    for (_, job, placed) in candidates {
        moved |= cheapen_frame(state, job, placed);
    }
    moved
}

fn cheapen_frame(state: &mut State, job: usize, placed: Placed) -> bool {
    let problem = state.problem;
    let work = &problem.jobs[job];
    let Some(frame) = work.frames.iter().find(|frame| Some(frame.number) == placed.task.frame()) else {
        return false;
    };
    let node = problem.nodes[placed.node];
    let saved = state.lanes[placed.node].saved_without(node, placed.start, placed.end);
    let cheaper: Vec<usize> = work
        .classes
        .iter()
        .copied()
        .filter(|&class| {
            let node = problem.representative(class);
            let price = node.duration(frame.work, work.job.class).map(|duration| node.price(duration, false));
            // On a node that is billed in steps, a frame may fit into time that is paid already.
            price.is_some_and(|price| price < saved || !node.is_plainly_billed())
        })
        .collect();
    let Some(release) = state.earliest(job, placed.task) else { return false };
    let search = Search {
        class_of_work: work.job.class,
        work: frame.work,
        release,
        latest_end: work.job.deadline.unwrap_or(i64::MAX),
        classes: &cheaper,
        prefer: Prefer::Cheap,
        except: Some(placed.node),
    };
    match state.find(work, &search) {
        Some((node, fit)) if fit.added_cost < saved => {
            state.unbook(job, placed);
            state.book(job, Placed { node, start: fit.start, end: fit.end, task: placed.task });
            true
        }
        _ => false,
    }
}
