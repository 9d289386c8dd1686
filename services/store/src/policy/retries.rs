//! Tasks that fail: when they are tried again, and when they fail their job.
//!
//! * A failed task waits before it is handed out again, twice as long each time. The node on which it failed
//!   gets it [`HEAD_START`] later than others, unless there is no other: another node is the better
//!   experiment.
//! * A task that failed on [`FAILED_NODES`] nodes is itself at fault. It fails its job. If there is no other
//!   node to try, failure number [`MAX_FAILURES`] does.
//! * A permanent error fails the job once [`AGREEING_NODES`] nodes say so. If there is no other node to ask,
//!   attempt number [`PERMANENT_ATTEMPTS`] does.
//! * The word of a node that is at fault for other tasks does not count in either.
//! * A task that exceeds its job's own limit of time or memory fails it at attempt number [`PERMANENT_ATTEMPTS`],
//!   if there is no other node to try: each attempt takes as long as the limit allows.
//! * Input that is gone fails the job at once.
//! * A task whose worker is lost goes to another node first, too: it may be the task that ends its workers. From
//!   loss number [`MAX_EXPIRIES`] on it fails its job, if it lost workers on two nodes or no other can try.

use forelight_protocol::{FailureKind, TaskError, TaskId};

/// Nodes on which a task fails before it fails its job.
pub const FAILED_NODES: u32 = 3;

/// Failures of a task that no other node can try, before it fails its job.
pub const MAX_FAILURES: u32 = 6;

/// Nodes that call an error permanent before it is believed.
pub const AGREEING_NODES: usize = 2;

/// Attempts of a task that no other node can try, before it is believed that its error is permanent, or its limit
/// too low.
pub const PERMANENT_ATTEMPTS: u32 = 3;

/// Lost workers of a task before it fails its job. More than failures: machines are switched off at night.
pub const MAX_EXPIRIES: u32 = 10;

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

/// A node on which a task failed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Witness {
    pub name: String,
    /// Whether it called the error permanent.
    pub permanent: bool,
    /// Whether it is at fault for other tasks.
    pub doubted: bool,
}

/// How often a task failed, where, and where it could be tried yet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tried<'a> {
    pub task: TaskId,
    /// Number of failures.
    pub failures: u32,
    pub witnesses: &'a [Witness],
    /// Whether another node could do the task, on which it has not failed.
    pub another: bool,
}

/// The error with which the job fails after a failure; `None` if the task is tried again.
pub(crate) fn job_error(error: &TaskError, tried: &Tried<'_>) -> Option<String> {
    let Tried { task, failures, witnesses, another } = *tried;
    if error.kind == FailureKind::Input {
        return Some(error.message.clone());
    }
    let believed = || witnesses.iter().filter(|witness| !witness.doubted);
    let is_agreed = believed().filter(|witness| witness.permanent).count() >= AGREEING_NODES;
    let will_repeat = error.permanent || error.limit.is_some();
    if error.permanent && is_agreed || will_repeat && !another && failures >= PERMANENT_ATTEMPTS {
        return Some(error.message.clone());
    }
    let is_shared = believed().count() >= FAILED_NODES as usize;
    if !is_shared && (another || failures < MAX_FAILURES) {
        return None;
    }
    let names: Vec<&str> = witnesses.iter().map(|witness| witness.name.as_str()).collect();
    let times = match names[..] {
        [one] => format!("{failures} times on {one}"),
        _ => format!("on {}", names.join(", ")),
    };
    Some(format!("{} (it failed {times}; the log of task {task} says more)", error.message))
}

/// The error that fails the job after so many lost workers of one task, on these nodes; `None` if the task is
/// tried again. `another`: whether another node could try.
pub(crate) fn job_error_of_lost_workers(expiries: u32, nodes: &[String], another: bool) -> Option<String> {
    (expiries >= MAX_EXPIRIES && (nodes.len() > 1 || !another))
        .then(|| format!("{expiries} workers were lost on this task, on {}", nodes.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::TaskLimit;

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

    fn witnesses(names: &[&str], permanent: bool) -> Vec<Witness> {
        let witness = |name: &&str| Witness { name: (*name).to_owned(), permanent, doubted: false };
        names.iter().map(witness).collect()
    }

    #[test]
    fn a_task_fails_its_job_on_the_third_node_or_at_the_sixth_time_where_there_is_no_other() {
        let error = TaskError { message: "out of memory".to_owned(), ..TaskError::default() };
        let found = |names: &[&str], failures, another| {
            let tried = Tried { task: TaskId::new(), failures, witnesses: &witnesses(names, false), another };
            job_error(&error, &tried)
        };
        assert_eq!(found(&["a", "b"], 5, false), None);
        assert_eq!(found(&["a"], 60, true), None, "another node could try");
        assert!(found(&["a", "b", "c"], 3, true).is_some_and(|it| it.contains("on a, b, c")));
        assert!(found(&["a"], 6, false).is_some_and(|it| it.contains("6 times on a")));
    }

    #[test]
    fn a_permanent_error_is_believed_of_two_nodes_that_are_not_at_fault_or_of_the_only_one_at_the_third_time()
    {
        let error = TaskError { message: "no such mesh".to_owned(), permanent: true, ..TaskError::default() };
        let found = |witnesses: &[Witness], failures, another| {
            job_error(&error, &Tried { task: TaskId::new(), failures, witnesses, another })
        };
        let one = witnesses(&["a"], true);
        assert_eq!((found(&one, 1, true), found(&one, 9, true), found(&one, 2, false)), (None, None, None));
        assert_eq!(found(&one, 3, false).as_deref(), Some("no such mesh"));
        let mut two = witnesses(&["a", "b"], true);
        assert_eq!(found(&two, 2, true).as_deref(), Some("no such mesh"));
        two[0].doubted = true;
        assert_eq!(found(&two, 2, true), None);
    }

    #[test]
    fn a_limit_that_is_exceeded_fails_the_job_at_the_third_time_where_there_is_no_other_node() {
        let error = TaskError {
            message: "beyond its limit".to_owned(),
            limit: Some(TaskLimit::WallTime),
            ..TaskError::default()
        };
        let found = |names: &[&str], failures, another| {
            let tried = Tried { task: TaskId::new(), failures, witnesses: &witnesses(names, false), another };
            job_error(&error, &tried)
        };
        // Another node may be faster, or have more memory.
        assert_eq!((found(&["a"], 2, false), found(&["a", "b"], 9, true)), (None, None));
        assert_eq!(found(&["a", "b"], 3, false).as_deref(), Some("beyond its limit"));
    }

    #[test]
    fn input_that_is_gone_fails_the_job_at_once() {
        let message = "its input is gone: bundle /shots/a".to_owned();
        let error = TaskError { message: message.clone(), kind: FailureKind::Input, ..TaskError::default() };
        let tried = Tried { task: TaskId::new(), failures: 1, witnesses: &[], another: true };
        assert_eq!(job_error(&error, &tried), Some(message));
    }

    #[test]
    fn lost_workers_are_counted_up_to_their_limit() {
        let nodes = ["a".to_owned(), "b".to_owned()];
        assert_eq!(job_error_of_lost_workers(9, &nodes, false), None);
        assert!(job_error_of_lost_workers(10, &nodes, true).is_some_and(|error| error.ends_with("on a, b")));
        assert_eq!(job_error_of_lost_workers(99, &nodes[..1], true), None, "another node could try");
        assert!(
            job_error_of_lost_workers(10, &nodes[..1], false).is_some_and(|error| error.ends_with("on a"))
        );
    }
}
