//! The free time of a node.

use crate::model::{FixedBooking, Node};

/// Stands for the end of an interval without end.
const FOREVER: i64 = i64::MAX;

/// Free intervals of one node: in order, disjoint, not empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct FreeTime {
    gaps: Vec<(i64, i64)>,
}

impl FreeTime {
    /// The node's calendar from the instant at which it is available, less the fixed bookings.
    pub fn new(node: &Node, fixed: &[FixedBooking]) -> Self {
        let mut open: Vec<(i64, i64)> = node
            .calendar
            .iter()
            .map(|interval| (interval.start.max(node.available_from), interval.end.unwrap_or(FOREVER)))
            .filter(|(start, end)| start < end)
            .collect();
        open.sort_unstable();
        let mut free = FreeTime { gaps: Vec::with_capacity(open.len()) };
        for (start, end) in open {
            match free.gaps.last_mut() {
                Some(last) if start <= last.1 => last.1 = last.1.max(end),
                _ => free.gaps.push((start, end)),
            }
        }
        fixed.iter().filter(|booking| booking.node == node.id).for_each(|b| free.take(b.start, b.end));
        free
    }

    /// Free intervals from `release` on.
    pub fn from(&self, release: i64) -> impl Iterator<Item = (i64, i64)> {
        self.gaps
            .iter()
            .map(move |&(start, end)| (start.max(release), end))
            .filter(|(start, end)| start < end)
    }

    /// The earliest start of an unbroken stretch of `duration` at `release` or later.
    pub fn earliest_start(&self, release: i64, duration: i64) -> Option<i64> {
        self.from(release)
            .find(|(start, end)| start.checked_add(duration).is_some_and(|finish| finish <= *end))
            .map(|(start, _)| start)
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
}

#[cfg(test)]
mod tests {
    use super::{FOREVER, FreeTime};
    use crate::model::{FixedBooking, Interval, Node};

    fn node(available_from: i64, calendar: &[(i64, Option<i64>)]) -> Node {
        Node {
            id: 1,
            name: String::new(),
            speed: 1,
            price_per_hour: 0,
            available_from,
            calendar: calendar.iter().map(|&(start, end)| Interval { start, end }).collect(),
        }
    }

    fn fixed(start: i64, end: i64) -> FixedBooking {
        FixedBooking { node: 1, start, end }
    }

    #[test]
    fn overlapping_touching_and_empty_intervals_are_tidied_up() {
        let node =
            node(3, &[(20, None), (10, Some(15)), (15, Some(18)), (0, Some(5)), (4, Some(6)), (8, Some(8))]);
        assert_eq!(FreeTime::new(&node, &[]).gaps, [(3, 6), (10, 18), (20, FOREVER)]);
    }

    #[test]
    fn fixed_bookings_cut_the_free_time_and_may_overlap() {
        let node = node(0, &[(0, Some(100))]);
        let found = FreeTime::new(
            &node,
            &[fixed(10, 20), fixed(15, 30), fixed(90, 200), fixed(50, 50), fixed(-5, 0)],
        );
        assert_eq!(found.gaps, [(0, 10), (30, 90)]);
    }

    #[test]
    fn bookings_of_other_nodes_do_not_matter() {
        let other = FixedBooking { node: 2, start: 0, end: 50 };
        assert_eq!(FreeTime::new(&node(0, &[(0, Some(9))]), &[other]).gaps, [(0, 9)]);
    }

    #[test]
    fn a_stretch_must_fit_into_one_interval() {
        let free = FreeTime::new(&node(0, &[(0, Some(10)), (20, Some(40))]), &[]);
        assert_eq!(free.earliest_start(0, 10), Some(0));
        assert_eq!(free.earliest_start(1, 10), Some(20));
        assert_eq!(free.earliest_start(30, 10), Some(30));
        assert_eq!(free.earliest_start(31, 10), None);
        assert_eq!(free.earliest_start(0, i64::MAX), None);
    }
}
