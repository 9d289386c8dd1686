//! Whose fault a failure is, and when a node is set aside for its faults.
//!
//! * A failure is held against a node only if others do not share it: the task succeeded elsewhere, its
//!   result was not possible, or it made no progress and another node was first. A worker that crashed, and was
//!   started again, has failed.
//! * Input that is gone is nobody's fault but its owner's, and a limit that a job set is the job's.
//! * A node whose tasks stalled [`STALLED`] times, or which is at fault for [`FAULTS`] tasks, within
//!   [`HELD_AGAINST`], is set aside. It gets no tasks until an operator brings it back.

use forelight_protocol::{FailureKind, TaskError};

/// Stalled tasks for which a node is set aside.
pub const STALLED: i64 = 2;

/// Tasks for which a node that is at fault is set aside.
pub const FAULTS: i64 = 3;

/// For how long a fault is held against a node: a day, in microseconds.
pub(crate) const HELD_AGAINST: i64 = 24 * 3_600_000_000;

/// What is held against a node.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Fault {
    /// It sent a result that is not possible.
    Refused,
    /// Its attempt made no progress, and another node was first.
    Stalled,
    /// Its attempt failed, and another node succeeded.
    Unshared,
}

impl Fault {
    /// As in the database.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Fault::Refused => "refused",
            Fault::Stalled => "stalled",
            Fault::Unshared => "unshared",
        }
    }

    fn in_words(name: &str) -> &'static str {
        match name {
            "refused" => "a result that is not possible",
            "stalled" => "no progress",
            _ => "a failure that no other node shared",
        }
    }
}

/// Tasks for which a node is at fault, within the time for which faults are held against it.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct Faults {
    /// Tasks that stalled.
    pub stalled: i64,
    /// All tasks.
    pub all: i64,
    /// The newest fault.
    pub last: Option<String>,
}

/// Why a node is set aside; `None` if it is not.
pub(crate) fn reason_to_set_aside(faults: &Faults) -> Option<String> {
    if faults.stalled < STALLED && faults.all < FAULTS {
        return None;
    }
    let last = faults.last.as_deref().map_or("unknown", Fault::in_words);
    Some(format!("it was at fault for {} tasks within a day, the last time: {last}", faults.all))
}

/// Where the cause of a failure lies, given what the service found out: the worker's word, except that a
/// limit is the job's, and that input which the service still has is not gone.
pub(crate) fn kind(error: &TaskError) -> FailureKind {
    if error.limit.is_some() { FailureKind::Task } else { error.kind }
}

/// The worker's error after the service has looked for the task's input. `missing` names what is gone.
pub(crate) fn after_a_look(error: TaskError, missing: Option<String>) -> TaskError {
    match missing {
        Some(missing) => {
            let message = format!("its input is gone: {missing}; bring it back and submit or retry the job");
            TaskError { message, permanent: false, kind: FailureKind::Input, limit: None }
        }
        None if error.kind == FailureKind::Input => TaskError { kind: FailureKind::Node, ..error },
        None => error,
    }
}

#[cfg(test)]
mod tests {
    use forelight_protocol::TaskLimit;

    use super::*;

    #[test]
    fn two_stalls_or_three_faults_set_a_node_aside_with_the_last_one_named() {
        let faults = |stalled, all| Faults { stalled, all, last: Some("stalled".to_owned()) };
        for few in [faults(0, 0), faults(1, 1), faults(1, 2), faults(0, 2)] {
            assert_eq!(reason_to_set_aside(&few), None, "{few:?}");
        }
        for many in [faults(2, 2), faults(0, 3), faults(1, 3)] {
            assert!(reason_to_set_aside(&many).is_some_and(|it| it.ends_with("no progress")), "{many:?}");
        }
    }

    #[test]
    fn a_worker_that_lacks_what_the_service_has_is_itself_the_cause() {
        let lacks =
            TaskError { kind: FailureKind::Input, message: "no a.zip".to_owned(), ..TaskError::default() };
        assert_eq!(after_a_look(lacks.clone(), None).kind, FailureKind::Node);
        let gone = after_a_look(lacks, Some("bundle /shots/a".to_owned()));
        assert_eq!(gone.kind, FailureKind::Input);
        assert!(gone.message.contains("/shots/a"), "{}", gone.message);
        // Whatever the worker noticed: without its input no task succeeds.
        let noticed = TaskError { permanent: true, message: "no mesh".to_owned(), ..TaskError::default() };
        assert_eq!(after_a_look(noticed, Some("bundle /shots/a".to_owned())).kind, FailureKind::Input);
    }

    #[test]
    fn a_limit_is_the_jobs() {
        let limited = TaskError { limit: Some(TaskLimit::Memory), ..TaskError::default() };
        assert_eq!(kind(&limited), FailureKind::Task);
    }
}
