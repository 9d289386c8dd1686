use std::cmp::Reverse;

use crate::problem::Problem;
use crate::state::State;

/// Compares plans, field by field. Less is better.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Score {
    broken: Vec<u64>,
    unplaced: usize,
    lateness: i128,
    cost: i64,
}

impl Score {
    pub fn of(state: &State) -> Self {
        let problem = state.problem;
        let is_late = |job: usize| {
            let deadline = problem.jobs[job].job.deadline;
            deadline.is_some() && !state.is_kept(job)
        };
        let mut score = Score { broken: broken(problem, is_late), unplaced: 0, lateness: 0, cost: 0 };
        for (job, work) in problem.jobs.iter().enumerate() {
            score.unplaced += state.missing(job).len() + usize::from(state.misses_shared_cache(job));
            if let Some(deadline) = work.job.deadline {
                score.lateness += (i128::from(state.finish(job)) - i128::from(deadline)).max(0);
            }
        }
        score.cost = state.cost();
        score
    }
}

/// Weights of the jobs that miss their deadline, by priority, highest first. Less is better.
pub(crate) fn broken(problem: &Problem, is_broken: impl Fn(usize) -> bool) -> Vec<u64> {
    let mut priorities: Vec<i32> = problem.jobs.iter().map(|work| work.job.priority).collect();
    priorities.sort_unstable_by_key(|&priority| Reverse(priority));
    priorities.dedup();
    let mut weights = vec![0; priorities.len()];
    for (_, work) in problem.jobs.iter().enumerate().filter(|&(job, _)| is_broken(job)) {
        let rank = priorities.partition_point(|&other| other > work.job.priority);
        weights[rank] += u64::from(work.job.worth());
    }
    weights
}
