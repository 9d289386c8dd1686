//! What a node's columns and changes mean.

use forelight_protocol::{ByClass, Node, NodeChange, NodeState, TaskId};

/// Two measured speeds are never quite the same. Up to this relative difference they count as equal: a tenth.
pub(crate) const SAME_SPEED: f64 = 0.1;

/// What an operator and the node's worker have said of it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Switches {
    /// The operator wants the node to finish its task and take no other.
    pub drain: bool,
    /// The operator wants the node to stop working for a while.
    pub pause: bool,
    /// The worker has stopped working.
    pub paused: bool,
    /// The node gets no tasks because too many failed on it, or because the operator said so.
    pub is_set_aside: bool,
}

/// The state of a node that holds `task`, as far as it does not depend on the clock.
pub(crate) fn state(switches: Switches, task: Option<TaskId>) -> NodeState {
    let Switches { drain, pause, paused, is_set_aside } = switches;
    match task {
        _ if is_set_aside => NodeState::SetAside,
        Some(_) if pause && !paused => NodeState::Pausing,
        _ if pause => NodeState::Paused,
        Some(_) if drain => NodeState::Draining,
        None if drain => NodeState::Drained,
        Some(_) => NodeState::Working,
        None => NodeState::Idle,
    }
}

/// The end of the sentence "node X …" for a change that plans take into account; `None` for any other.
pub(crate) fn cause_of(change: &NodeChange) -> Option<&'static str> {
    if change.drain == Some(true) {
        Some("is drained")
    } else if change.set_aside == Some(true) {
        Some("is set aside")
    } else if change.pause == Some(true) {
        Some("is paused")
    } else if [change.drain, change.pause, change.set_aside].contains(&Some(false)) {
        Some("is back")
    } else if change.schedule.is_some() || change.terms.is_some() {
        Some("has another calendar or other terms")
    } else if change.speed.is_some() || change.price_per_hour.is_some() {
        Some("has another speed or price")
    } else {
        None
    }
}

/// Whether a change may let the node take tasks that it could not take before.
pub(crate) fn may_take_tasks_again(change: &NodeChange) -> bool {
    [change.drain, change.pause, change.set_aside].contains(&Some(false))
        || change.schedule.is_some()
        || change.terms.is_some()
}

/// Whether plans see the same machine in both.
pub(crate) fn is_same_machine(one: &Node, other: &Node) -> bool {
    let terms = |node: &Node| (node.price_per_hour, node.cores, node.schedule.clone());
    let alike = |one: f64, other: f64| (one / other - 1.0).abs() < SAME_SPEED;
    // One class of work at a time, as far as the nodes are calibrated.
    let classes = (0..ByClass::CLASSES).all(|class| {
        let work = ByClass::from_array(std::array::from_fn(|each| u64::from(each == class)));
        match (one.speed_by_class(Some(&work)), other.speed_by_class(Some(&work))) {
            (Some(one), Some(other)) => alike(one, other),
            (one, other) => one.is_none() && other.is_none(),
        }
    });
    let has_same_renderers = one.capabilities.renderers == other.capabilities.renderers;
    has_same_renderers && terms(one) == terms(other) && alike(one.speed, other.speed) && classes
}

#[cfg(test)]
pub(crate) mod tests {
    use forelight_protocol::{Money, NodeId, Timestamp};

    use super::*;

    /// An idle node of speed 1 with one core, for one unit of the currency an hour.
    pub(crate) fn node() -> Node {
        let at = Timestamp::from_micros(1_800_000_000_000_000);
        Node {
            id: NodeId::new(),
            name: "a".to_owned(),
            speed: 1.0,
            speed_set: false,
            price_per_hour: Money(1_000_000),
            price_set: false,
            time_factor: 1.0,
            cores: 1,
            capabilities: Default::default(),
            schedule_set: false,
            schedule: None,
            terms: Default::default(),
            power: None,
            state: NodeState::Idle,
            drain: false,
            pause: false,
            set_aside: None,
            idle_reason: None,
            task_id: None,
            activity: None,
            created_at: at,
            last_seen_at: at,
        }
    }

    #[test]
    fn set_aside_goes_before_all_else_and_a_pause_begins_when_the_worker_says_so() {
        let task = Some(TaskId::new());
        let all = Switches { drain: true, pause: true, paused: false, is_set_aside: true };
        assert_eq!(state(all, task), NodeState::SetAside);
        let pausing = Switches { is_set_aside: false, ..all };
        assert_eq!(state(pausing, task), NodeState::Pausing);
        assert_eq!(state(Switches { paused: true, ..pausing }, task), NodeState::Paused);
        assert_eq!(state(pausing, None), NodeState::Paused);
        let draining = Switches { drain: true, ..Switches::default() };
        assert_eq!(state(draining, task), NodeState::Draining);
        assert_eq!(state(draining, None), NodeState::Drained);
        assert_eq!(state(Switches::default(), task), NodeState::Working);
    }

    #[test]
    fn plans_ignore_a_speed_that_was_measured_a_little_differently() {
        let one = node();
        assert!(is_same_machine(&Node { speed: 1.05, ..one.clone() }, &one));
        assert!(!is_same_machine(&Node { speed: 1.2, ..one.clone() }, &one));
        assert!(!is_same_machine(&Node { cores: 2, ..one.clone() }, &one));
    }

    #[test]
    fn a_change_that_only_takes_a_task_away_calls_for_no_plan() {
        assert_eq!(cause_of(&NodeChange { cancel_task: Some(true), ..NodeChange::default() }), None);
        let back = NodeChange { drain: Some(false), ..NodeChange::default() };
        assert_eq!((cause_of(&back), may_take_tasks_again(&back)), (Some("is back"), true));
    }
}
