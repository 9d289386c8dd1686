//! When nodes are available: awake by their calendars, outside maintenance, and heard of lately.

use std::time::Duration;

use forelight_planner as planner;
use forelight_planner::{Interval, Weekly};
use forelight_protocol::{
    ByClass, Node, NodeCalendar, NodePower, NodeState, NodeWindow, PowerState, Timestamp,
};
use jiff::tz::TimeZone;

const DAY: i64 = 86_400_000_000;

/// How far ahead calendars are read to find when a node falls asleep or wakes up: two weeks, in microseconds.
const HORIZON: i64 = 14 * DAY;

/// Whether a node is awake at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Opening {
    /// The node is awake until this instant. `None`: for at least two weeks.
    Awake(Option<Timestamp>),
    /// The node is asleep until this instant. `None`: for at least two weeks.
    Asleep(Option<Timestamp>),
}

/// The node's free time between two instants, in order: its calendar less its maintenance. Without a calendar
/// the last interval has no end.
pub fn free_time_of(node: &Node, from: Timestamp, until: Timestamp) -> Vec<Interval> {
    let (from, until) = (from.micros(), until.micros());
    let calendar = match &node.schedule {
        None => vec![Interval { start: from, end: None }],
        // Calendars are checked when they are set. So the time zone is known, and expanding fails only for
        // years far outside any schedule.
        Some(calendar) => weekly(calendar)
            .and_then(|windows| planner::expand(&windows, from, until).ok())
            .unwrap_or_default(),
    };
    let maintenance = node
        .terms
        .maintenance
        .iter()
        .map(|span| Interval { start: span.start.micros(), end: span.end.map(Timestamp::micros) });
    let node = planner::Node { calendar, maintenance: maintenance.collect(), ..planner::Node::default() };
    planner::free_time(&node, from, &[])
}

/// The calendar as the planner's types. `None` if its time zone is unknown.
fn weekly(calendar: &NodeCalendar) -> Option<Vec<Weekly>> {
    let zone = TimeZone::get(&calendar.zone).ok()?;
    let weekly = |window: &NodeWindow| Weekly {
        zone: zone.clone(),
        days: window.days.clone(),
        from: window.from,
        until: window.until,
    };
    Some(calendar.windows.iter().map(weekly).collect())
}

/// Whether the node is awake at `now`, and until when.
pub fn opening(node: &Node, now: Timestamp) -> Opening {
    if node.schedule.is_none() && node.terms.maintenance.is_empty() {
        return Opening::Awake(None);
    }
    let horizon = now.plus_micros(HORIZON);
    let within = |instant: i64| Some(Timestamp::from_micros(instant)).filter(|&instant| instant < horizon);
    match free_time_of(node, now, horizon).first() {
        None => Opening::Asleep(None),
        Some(first) if first.start > now.micros() => Opening::Asleep(within(first.start)),
        Some(first) => Opening::Awake(first.end.and_then(within)),
    }
}

/// Microseconds since the node was last heard of, counting only the time in which it was awake: a node that
/// sleeps by its calendar is not lost.
pub fn silence(node: &Node, now: Timestamp) -> i64 {
    let awake = free_time_of(node, node.last_seen_at, now);
    awake.iter().fold(0i64, |sum, interval| {
        let end = interval.end.map_or(now.micros(), |end| end.min(now.micros()));
        sum.saturating_add(end.saturating_sub(interval.start).max(0))
    })
}

/// After this many microseconds without a message a node counts as silent: three lease times.
pub(crate) fn silent_after(ttl: Duration) -> i64 {
    i64::try_from(ttl.as_micros()).map_or(i64::MAX / 2, |ttl| ttl.saturating_mul(3))
}

/// The node with its power state filled in, and in the state `Silent` if it was silent for too long.
#[must_use]
pub fn as_it_is(node: Node, ttl: Duration, now: Timestamp) -> Node {
    let should_speak = matches!(node.state, NodeState::Idle | NodeState::Working);
    let node = with_power(node, now);
    if should_speak && silence(&node, now) > silent_after(ttl) {
        // The reason it was idle when it last asked no longer applies.
        return Node { state: NodeState::Silent, idle_reason: None, ..node };
    }
    node
}

/// The node with its power state filled in.
#[must_use]
pub(crate) fn with_power(node: Node, now: Timestamp) -> Node {
    let power = match opening(&node, now) {
        Opening::Awake(until) => NodePower { state: PowerState::Awake, until },
        Opening::Asleep(until) => NodePower { state: PowerState::Asleep, until },
    };
    Node { power: Some(power), ..node }
}

/// Forecast CPU seconds of a job that the node renders in this many microseconds. As in plans, at its speed
/// for the job's classes of work, and with the factor that finished frames put on the forecast.
pub(crate) fn forecast_seconds_within(micros: i64, node: &Node, work: Option<&ByClass>, factor: f64) -> f64 {
    let seconds = micros.max(0) as f64 * 1e-6 * f64::from(node.cores);
    seconds * node.speed_for(work) / factor
}

#[cfg(test)]
mod tests {
    use forelight_protocol::TimeSpan;

    use super::*;
    use crate::policy::nodes::tests::node;

    const HOUR: i64 = 3_600_000_000;

    /// A node with maintenance from one hour to another after it was last seen.
    fn maintained(from: i64, until: Option<i64>) -> Node {
        let mut node = node();
        let at = |hours: i64| node.last_seen_at.plus_micros(hours * HOUR);
        let span = TimeSpan { start: at(from), end: until.map(at) };
        node.terms.maintenance = vec![span];
        node
    }

    #[test]
    fn a_node_is_awake_until_its_maintenance_and_asleep_until_that_ends() {
        let node = maintained(2, Some(5));
        let at = |hours: i64| node.last_seen_at.plus_micros(hours * HOUR);
        assert_eq!(opening(&node, at(0)), Opening::Awake(Some(at(2))));
        assert_eq!(opening(&node, at(3)), Opening::Asleep(Some(at(5))));
        assert_eq!(opening(&node, at(5)), Opening::Awake(None));
        assert_eq!(opening(&maintained(2, None), at(3)), Opening::Asleep(None));
    }

    #[test]
    fn time_asleep_is_no_silence() {
        let node = maintained(2, Some(5));
        let at = |hours: i64| node.last_seen_at.plus_micros(hours * HOUR);
        assert_eq!(
            (silence(&node, at(2)), silence(&node, at(4)), silence(&node, at(6))),
            (2 * HOUR, 2 * HOUR, 3 * HOUR)
        );
        let ttl = Duration::from_secs(3600);
        assert_eq!(as_it_is(node.clone(), ttl, at(6)).state, NodeState::Idle);
        assert_eq!(as_it_is(node.clone(), ttl, at(7)).state, NodeState::Silent);
    }

    #[test]
    fn a_window_holds_as_many_seconds_as_cores_and_speed_make_of_it() {
        let node = Node { cores: 4, speed: 2.0, ..node() };
        assert_eq!(forecast_seconds_within(10_000_000, &node, None, 0.5), 160.0);
        assert_eq!(forecast_seconds_within(-1, &node, None, 1.0), 0.0);
    }
}
