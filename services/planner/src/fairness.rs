//! Turns among jobs without a deadline.
//!
//! Weighted fair queueing over node time. The next frame belongs to the project with the least use for its
//! share and, within it, to the job with the least time for its weight. Past use of a project decays with a
//! half-life.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use crate::model::{Input, Project};
use crate::problem::Problem;

/// Node time that a project used, decayed to `now`, microseconds.
pub fn decayed_usage(project: &Project, now: i64, half_life: i64) -> i64 {
    project.usage.iter().fold(0i64, |sum, usage| {
        sum.saturating_add(decayed(usage.time.max(0), now.saturating_sub(usage.at).max(0), half_life))
    })
}

/// Halves with each half-life, linear between two of them.
fn decayed(time: i64, age: i64, half_life: i64) -> i64 {
    if half_life <= 0 {
        return time;
    }
    let halvings = age / half_life;
    if halvings >= 63 {
        return 0;
    }
    let (high, low) = (i128::from(time >> halvings), i128::from(time >> (halvings + 1)));
    let part = (high - low) * i128::from(age % half_life) / i128::from(half_life);
    // The value lies between two halvings of an `i64`.
    i64::try_from(high - part).unwrap_or(i64::MAX)
}

pub(crate) struct Turns {
    projects: BTreeMap<Option<u64>, Had>,
    jobs: Vec<Had>,
}

#[derive(Clone, Copy, Debug)]
struct Had {
    time: i128,
    share: u32,
}

impl Had {
    /// The one with less time for its share comes first.
    fn compare(&self, other: &Had) -> Ordering {
        let mine = self.time.saturating_mul(i128::from(other.share));
        mine.cmp(&other.time.saturating_mul(i128::from(self.share)))
    }
}

impl Turns {
    pub fn new(problem: &Problem) -> Self {
        let input: &Input = problem.input;
        let mut projects: BTreeMap<Option<u64>, Had> = input
            .projects
            .iter()
            .map(|project| {
                let time = decayed_usage(project, input.now, input.half_life);
                (Some(project.id), Had { time: i128::from(time), share: project.share.max(1) })
            })
            .collect();
        projects.insert(None, Had { time: 0, share: 1 });
        let jobs = problem.jobs.iter().map(|work| Had { time: 0, share: work.job.worth() }).collect();
        Turns { projects, jobs }
    }

    /// The job whose turn it is. `waiting` holds indices of jobs and their projects.
    pub fn next(&self, waiting: &[(usize, Option<u64>)]) -> Option<usize> {
        let order = |a: &&(usize, Option<u64>), b: &&(usize, Option<u64>)| {
            let projects = match (self.projects.get(&a.1), self.projects.get(&b.1)) {
                (Some(one), Some(other)) => one.compare(other).then(a.1.cmp(&b.1)),
                (one, other) => one.is_some().cmp(&other.is_some()),
            };
            projects.then_with(|| self.jobs[a.0].compare(&self.jobs[b.0])).then(a.0.cmp(&b.0))
        };
        waiting.iter().min_by(order).map(|&(job, _)| job)
    }

    pub fn had(&mut self, job: usize, project: Option<u64>, time: i64) {
        self.jobs[job].time += i128::from(time);
        if let Some(had) = self.projects.get_mut(&project) {
            had.time += i128::from(time);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::decayed_usage;
    use crate::model::{Project, Usage};

    #[test]
    fn what_was_used_counts_half_after_a_half_life_and_nothing_after_many() {
        let project = |at, time| Project { id: 1, usage: vec![Usage { at, time }], ..Project::default() };
        assert_eq!(decayed_usage(&project(0, 1000), 0, 100), 1000);
        assert_eq!(decayed_usage(&project(0, 1000), 50, 100), 750);
        assert_eq!(decayed_usage(&project(0, 1000), 100, 100), 500);
        assert_eq!(decayed_usage(&project(0, 1000), 200, 100), 250);
        assert_eq!(decayed_usage(&project(0, i64::MAX), i64::MAX, 1), 0);
        assert_eq!(decayed_usage(&project(0, 1000), 999, 0), 1000);
        assert_eq!(decayed_usage(&project(500, 1000), 0, 100), 1000, "nothing counts more than it was");
    }
}
