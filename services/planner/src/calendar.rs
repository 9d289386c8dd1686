//! Free time of nodes.

use crate::intervals::Intervals;
use crate::model::{FixedBooking, Interval, Node, Power};

pub(crate) const FOREVER: i64 = i64::MAX;

/// The node's calendar from `available_from` on, less maintenance.
fn open_time(node: &Node, now: i64) -> Intervals {
    let from = node.available_from.max(now);
    let until = |interval: &Interval| interval.end.unwrap_or(FOREVER);
    let mut open =
        Intervals::union(node.calendar.iter().map(|open| (open.start.max(from), until(open))).collect());
    node.maintenance.iter().for_each(|closed| open.take(closed.start, until(closed)));
    open
}

/// An unbroken stretch of a node's free time, without any planned bookings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    pub start: i64,
    pub end: i64,
    /// The node already runs when the window begins.
    pub warm: bool,
}

impl Window {
    /// When the node can begin its first task: after its set-up.
    pub fn ready(&self, node: &Node) -> i64 {
        if self.warm { self.start } else { self.start.saturating_add(node.setup) }
    }
}

/// A node's calendar less its fixed bookings.
pub(crate) fn windows(node: &Node, now: i64, fixed: &[&FixedBooking]) -> Vec<Window> {
    let mut free = open_time(node, now);
    fixed.iter().for_each(|booking| free.take(booking.start, booking.end));
    let mut ends: Vec<i64> = fixed.iter().filter(|b| b.start < b.end).map(|b| b.end).collect();
    ends.sort_unstable();
    let first = node.available_from.max(now);
    free.iter()
        .map(|(start, end)| Window {
            start,
            end,
            warm: (node.power == Power::On && start == first) || ends.binary_search(&start).is_ok(),
        })
        .collect()
}

/// A node's free time from `now` on: its calendar, less maintenance and fixed bookings. In order; intervals
/// do not touch.
pub fn free_time(node: &Node, now: i64, fixed: &[FixedBooking]) -> Vec<Interval> {
    let of_node: Vec<&FixedBooking> = fixed.iter().filter(|booking| booking.node == node.id).collect();
    windows(node, now, &of_node)
        .iter()
        .map(|window| Interval { start: window.start, end: Some(window.end).filter(|&end| end < FOREVER) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{FOREVER, Window, windows};
    use crate::model::{FixedBooking, Interval, Node, Power};

    fn node(available_from: i64, calendar: &[(i64, Option<i64>)]) -> Node {
        Node {
            id: 1,
            speed: 1,
            available_from,
            calendar: calendar.iter().map(|&(start, end)| Interval { start, end }).collect(),
            ..Node::default()
        }
    }

    fn fixed(start: i64, end: i64) -> FixedBooking {
        FixedBooking { node: 1, start, end, ..FixedBooking::default() }
    }

    fn free(node: &Node, fixed: &[FixedBooking]) -> Vec<(i64, i64)> {
        windows(node, 0, &fixed.iter().collect::<Vec<_>>()).iter().map(|w| (w.start, w.end)).collect()
    }

    #[test]
    fn overlapping_touching_and_empty_intervals_are_tidied_up() {
        let node =
            node(3, &[(20, None), (10, Some(15)), (15, Some(18)), (0, Some(5)), (4, Some(6)), (8, Some(8))]);
        assert_eq!(free(&node, &[]), [(3, 6), (10, 18), (20, FOREVER)]);
    }

    #[test]
    fn fixed_bookings_and_maintenance_cut_the_free_time_and_may_overlap() {
        let mut node = node(0, &[(0, Some(100))]);
        let bookings = [fixed(10, 20), fixed(15, 30), fixed(90, 200), fixed(50, 50), fixed(-5, 0)];
        assert_eq!(free(&node, &bookings), [(0, 10), (30, 90)]);
        node.maintenance = vec![Interval { start: 60, end: None }, Interval { start: 40, end: Some(40) }];
        assert_eq!(free(&node, &bookings), [(0, 10), (30, 60)]);
    }

    #[test]
    fn a_node_runs_after_a_fixed_booking_and_when_it_is_on() {
        let mut node = node(5, &[(0, Some(30)), (50, Some(60))]);
        let cold = |start, end| Window { start, end, warm: false };
        let booking = fixed(10, 20);
        assert_eq!(
            windows(&node, 0, &[&booking]),
            [cold(5, 10), Window { start: 20, end: 30, warm: true }, cold(50, 60)]
        );
        node.power = Power::On;
        let warm = |now| windows(&node, now, &[]).iter().map(|w| w.warm).collect::<Vec<_>>();
        assert_eq!((warm(0), warm(40)), (vec![true, false], vec![false]));
    }
}
