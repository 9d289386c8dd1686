//! Free time.

use crate::model::{FixedBooking, Interval, Node, Power};

/// Stands for the end of an interval without end.
pub(crate) const FOREVER: i64 = i64::MAX;

/// Intervals: in order, disjoint, not touching, not empty.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct FreeTime {
    gaps: Vec<(i64, i64)>,
}

impl FreeTime {
    /// The union of these intervals.
    pub fn union(mut intervals: Vec<(i64, i64)>) -> Self {
        intervals.retain(|(start, end)| start < end);
        intervals.sort_unstable();
        let mut gaps: Vec<(i64, i64)> = Vec::with_capacity(intervals.len());
        for (start, end) in intervals {
            match gaps.last_mut() {
                Some(last) if start <= last.1 => last.1 = last.1.max(end),
                _ => gaps.push((start, end)),
            }
        }
        FreeTime { gaps }
    }

    /// The node's calendar from the instant at which it is available, less maintenance.
    pub fn of_calendar(node: &Node, now: i64) -> Self {
        let from = node.available_from.max(now);
        let until = |interval: &Interval| interval.end.unwrap_or(FOREVER);
        let mut free =
            Self::union(node.calendar.iter().map(|open| (open.start.max(from), until(open))).collect());
        node.maintenance.iter().for_each(|closed| free.take(closed.start, until(closed)));
        free
    }

    /// The intervals.
    pub fn gaps(&self) -> &[(i64, i64)] {
        &self.gaps
    }

    /// Length of the longest interval.
    pub fn longest(&self) -> i64 {
        self.gaps.iter().map(|(start, end)| end.saturating_sub(*start)).max().unwrap_or(0)
    }

    /// Index of the first interval that ends after this instant.
    pub fn first_after(&self, instant: i64) -> usize {
        self.gaps.partition_point(|gap| gap.1 <= instant)
    }

    /// Takes the time from `start` to just before `end` away, whether it was free or not.
    pub fn take(&mut self, start: i64, end: i64) {
        if start >= end {
            return;
        }
        let first = self.gaps.partition_point(|gap| gap.1 <= start);
        let beyond = self.gaps.partition_point(|gap| gap.0 < end);
        if first >= beyond {
            return;
        }
        let left = (self.gaps[first].0, start);
        let right = (end, self.gaps[beyond - 1].1);
        let rest = [left, right].into_iter().filter(|(start, end)| start < end);
        self.gaps.splice(first..beyond, rest);
    }

    /// Gives time back that was taken and is not free; it joins what it touches.
    pub fn give(&mut self, start: i64, end: i64) {
        let at = self.gaps.partition_point(|gap| gap.1 < start);
        let mut joined = (start, end);
        let mut beyond = at;
        while let Some(gap) = self.gaps.get(beyond).filter(|gap| gap.0 <= joined.1) {
            joined = (joined.0.min(gap.0), joined.1.max(gap.1));
            beyond += 1;
        }
        self.gaps.splice(at..beyond, [joined]);
    }
}

/// An unbroken stretch of a node's free time, before anything is planned into it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    pub start: i64,
    pub end: i64,
    /// The node runs when it begins.
    pub warm: bool,
}

/// The free stretches of a node: its calendar less the fixed bookings, which are those of this node.
pub(crate) fn windows(node: &Node, now: i64, fixed: &[&FixedBooking]) -> Vec<Window> {
    let mut free = FreeTime::of_calendar(node, now);
    fixed.iter().for_each(|booking| free.take(booking.start, booking.end));
    let mut ends: Vec<i64> = fixed.iter().filter(|b| b.start < b.end).map(|b| b.end).collect();
    ends.sort_unstable();
    let first = node.available_from.max(now);
    free.gaps
        .iter()
        .map(|&(start, end)| Window {
            start,
            end,
            warm: (node.power == Power::On && start == first) || ends.binary_search(&start).is_ok(),
        })
        .collect()
}

/// When the node may be used from this instant on: its calendar, less maintenance and what is booked on it. In order; nothing touches.
pub fn free_time(node: &Node, now: i64, fixed: &[FixedBooking]) -> Vec<Interval> {
    let of_node: Vec<&FixedBooking> = fixed.iter().filter(|booking| booking.node == node.id).collect();
    windows(node, now, &of_node)
        .iter()
        .map(|window| Interval { start: window.start, end: Some(window.end).filter(|&end| end < FOREVER) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{FOREVER, FreeTime, Window, windows};
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

    #[test]
    fn what_is_given_back_joins_its_neighbours() {
        let mut free = FreeTime::union(vec![(0, 100)]);
        free.take(10, 20);
        free.take(20, 30);
        free.give(10, 20);
        assert_eq!(free.gaps(), [(0, 20), (30, 100)]);
        free.give(20, 30);
        assert_eq!(free.gaps(), [(0, 100)]);
        free.take(0, 100);
        free.give(40, 50);
        assert_eq!(free.gaps(), [(40, 50)]);
        assert_eq!((free.first_after(49), free.first_after(50)), (0, 1));
    }
}
