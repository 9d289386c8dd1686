//! When nodes are awake.

use std::time::Duration;

use forelight_planner as planner;
use forelight_planner::{Interval, Weekly};
use forelight_protocol::{Node, NodeCalendar, NodePower, NodeState, NodeWindow, PowerState, Timestamp};
use jiff::tz::TimeZone;

const DAY: i64 = 86_400_000_000;

/// How far ahead calendars are looked at to say until when a node is awake or asleep: two weeks, in microseconds.
const AHEAD: i64 = 14 * DAY;

/// Whether a node is awake at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Opening {
    /// It is, until then; without end if nothing is known to close it within two weeks.
    Awake(Option<Timestamp>),
    /// It is not, until then; for longer than two weeks if that is not known.
    Asleep(Option<Timestamp>),
}

/// The node's free time between two instants, in order: its calendar less its maintenance. The last interval has no end if the
/// node has no calendar.
pub fn free_time_of(node: &Node, from: Timestamp, until: Timestamp) -> Vec<Interval> {
    let (from, until) = (from.micros(), until.micros());
    let calendar = match &node.schedule {
        None => vec![Interval { start: from, end: None }],
        // A calendar was checked when it came in, so its zone is known. The years for which it cannot be expanded are
        // far away.
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

/// The calendar in the planner's words; `None` if its time zone is not known.
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

/// Whether the node is awake now, and until when that is so.
pub fn opening(node: &Node, now: Timestamp) -> Opening {
    if node.schedule.is_none() && node.terms.maintenance.is_empty() {
        return Opening::Awake(None);
    }
    let horizon = now.plus_micros(AHEAD);
    let within = |instant: i64| Some(Timestamp::from_micros(instant)).filter(|&instant| instant < horizon);
    match free_time_of(node, now, horizon).first() {
        None => Opening::Asleep(None),
        Some(first) if first.start > now.micros() => Opening::Asleep(within(first.start)),
        Some(first) => Opening::Awake(first.end.and_then(within)),
    }
}

/// For how many microseconds of the time in which it was awake the node has not been heard of: a node that sleeps by its calendar is
/// not lost.
pub fn silence(node: &Node, now: Timestamp) -> i64 {
    let awake = free_time_of(node, node.last_seen_at, now);
    awake.iter().fold(0i64, |sum, interval| {
        let end = interval.end.map_or(now.micros(), |end| end.min(now.micros()));
        sum.saturating_add(end.saturating_sub(interval.start).max(0))
    })
}

/// After so many microseconds without a word a node no longer counts as there: three lease times.
pub(crate) fn silent_after(ttl: Duration) -> i64 {
    i64::try_from(ttl.as_micros()).map_or(i64::MAX / 2, |ttl| ttl.saturating_mul(3))
}

/// The node as it is now: with its power, and whether it has fallen silent.
#[must_use]
pub fn as_it_is(node: Node, ttl: Duration, now: Timestamp) -> Node {
    let should_speak = matches!(node.state, NodeState::Idle | NodeState::Working);
    let node = with_power(node, now);
    if should_speak && silence(&node, now) > silent_after(ttl) {
        // Why it got nothing when it last asked is no longer why.
        return Node { state: NodeState::Silent, idle_reason: None, ..node };
    }
    node
}

/// The node with its power filled in.
#[must_use]
pub(crate) fn with_power(node: Node, now: Timestamp) -> Node {
    let power = match opening(&node, now) {
        Opening::Awake(until) => NodePower { state: PowerState::Awake, until },
        Opening::Asleep(until) => NodePower { state: PowerState::Asleep, until },
    };
    Node { power: Some(power), ..node }
}
