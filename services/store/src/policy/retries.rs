//! Tasks that fail: when they are tried again, when no more, and when the node is at fault.
//!
//! * A failed task waits before it is handed out again, twice as long each time. The node on which it failed
//!   gets it [`HEAD_START`] later than others: another node is the better experiment.
//! * A task that failed on [`FAILED_NODES`] nodes is itself at fault. It fails its job. On fewer nodes,
//!   failure number [`MAX_FAILURES`] does.
//! * A node on which tasks of [`FAILED_JOBS`] jobs failed within [`HELD_AGAINST`] is at fault and is set
//!   aside, unless those tasks failed their jobs. It gets no tasks until an operator brings it back. So a job
//!   that fails everywhere does not take the farm with it.
//! * A task whose worker is lost [`MAX_EXPIRIES`] times fails its job.

use forelight_protocol::{TaskError, TaskId};

/// Nodes on which a task fails before it fails its job.
pub const FAILED_NODES: u32 = 3;

/// Failures of a task, on however few nodes, before it fails its job.
pub const MAX_FAILURES: u32 = 6;

/// Jobs that fail on a node before it is set aside.
pub const FAILED_JOBS: u32 = 3;

/// Lost workers of a task before it fails its job. More than failures: machines are switched off at night.
pub const MAX_EXPIRIES: u32 = 10;

/// For how long a failure is held against a node: a day, in microseconds.
pub(crate) const HELD_AGAINST: i64 = 24 * 3_600_000_000;

/// The first wait of a failed task, at most: a second, in microseconds.
const FIRST_WAIT: i64 = 1_000_000;

/// The longest wait of a failed task: a minute, in microseconds.
pub(crate) const LONGEST_WAIT: i64 = 60_000_000;

/// How long after its wait a task is kept for nodes on which it has not failed: ten seconds, in microseconds.
pub(crate) const HEAD_START: i64 = 10_000_000;

/// How long a task waits after failure number `failures` (from 1), in microseconds: between half a ceiling
/// and the whole of it. The ceiling doubles from a second to a minute. The jitter is a hash of task and
/// number, so the tasks of a job do not come back at once, and a run can be repeated exactly.
pub(crate) fn wait(task: TaskId, failures: u32) -> i64 {
    let doublings = failures.saturating_sub(1).min(16);
    let half = FIRST_WAIT.saturating_mul(1 << doublings).min(LONGEST_WAIT) / 2;
    let mut hasher = blake3::Hasher::new();
    hasher.update(task.0.as_bytes()).update(&failures.to_le_bytes());
    let [a, b, c, d, ..] = *hasher.finalize().as_bytes();
    half + i64::from(u32::from_le_bytes([a, b, c, d])) * half / i64::from(u32::MAX)
}

/// Whether an error says nothing about the node: any node would have met it, or a limit that the job set was
/// exceeded.
pub(crate) fn is_blameless(error: &TaskError) -> bool {
    error.permanent || error.limit.is_some()
}

/// The error with which the job fails after failure number `failures` of the task, which failed on these
/// nodes; `None` if the task is tried again.
pub(crate) fn job_error(
    error: &TaskError,
    task: TaskId,
    failures: u32,
    failed_on: &[String],
) -> Option<String> {
    if error.permanent {
        return Some(error.message.clone());
    }
    if failed_on.len() < FAILED_NODES as usize && failures < MAX_FAILURES {
        return None;
    }
    let times = match failed_on {
        [one] => format!("{failures} times on {one}"),
        several => format!("on {}", several.join(", ")),
    };
    Some(format!("{} (it failed {times}; the log of task {task} says more)", error.message))
}

/// The error that fails the job after so many lost workers of one task; `None` if the task is tried again.
pub(crate) fn job_error_of_lost_workers(expiries: u32) -> Option<String> {
    (expiries >= MAX_EXPIRIES).then(|| format!("{expiries} workers were lost on this task"))
}

/// Why a node is set aside on which tasks of so many jobs failed, the last with `error`; `None` if it is not.
pub(crate) fn reason_to_set_aside(jobs: i64, error: &str) -> Option<String> {
    (jobs >= i64::from(FAILED_JOBS))
        .then(|| format!("tasks of {jobs} jobs failed on it within a day, the last one with: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_a_minute_and_can_be_repeated() {
        let task = TaskId::new();
        for (failures, ceiling) in [(1, 1), (2, 2), (3, 4), (6, 32), (7, 60), (40, 60), (u32::MAX, 60)] {
            let waited = wait(task, failures);
            let ceiling = ceiling * 1_000_000;
            assert!((ceiling / 2..=ceiling).contains(&waited), "{failures}: {waited}");
            assert_eq!(waited, wait(task, failures));
        }
        let others: std::collections::BTreeSet<i64> = (0..20).map(|_| wait(TaskId::new(), 5)).collect();
        assert!(others.len() > 10, "tasks that failed together come back together: {others:?}");
    }

    #[test]
    fn a_task_fails_its_job_on_the_third_node_at_the_sixth_time_or_with_a_permanent_error() {
        let task = TaskId::new();
        let error = TaskError { message: "out of memory".to_owned(), ..TaskError::default() };
        let nodes = |count: usize| -> Vec<String> { (0..count).map(|node| format!("n{node}")).collect() };
        assert_eq!(job_error(&error, task, 5, &nodes(2)), None);
        assert!(job_error(&error, task, 3, &nodes(3)).is_some_and(|it| it.contains("on n0, n1, n2")));
        assert!(job_error(&error, task, 6, &nodes(1)).is_some_and(|it| it.contains("6 times on n0")));
        let permanent = TaskError { permanent: true, ..error };
        assert_eq!(job_error(&permanent, task, 1, &nodes(1)).as_deref(), Some("out of memory"));
        assert!(is_blameless(&permanent));
    }

    #[test]
    fn lost_workers_and_failed_jobs_are_counted_up_to_their_limits() {
        assert_eq!(job_error_of_lost_workers(9), None);
        assert!(job_error_of_lost_workers(10).is_some());
        assert_eq!(reason_to_set_aside(2, "no memory"), None);
        assert!(reason_to_set_aside(3, "no memory").is_some_and(|it| it.ends_with("no memory")));
    }
}
