//! The free time of a class of nodes, kept up to date as bookings come and go.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use crate::gaps::{Gap, Gaps};
use crate::lane::Lane;
use crate::model::Node;
use crate::problem::Problem;

/// The free time of a class of nodes.
#[derive(Clone, Debug)]
pub(crate) struct Pool {
    gaps: Gaps,
    /// Nodes billed in steps that have bookings: what is paid for unused time, most first.
    overpaid: BTreeSet<(Reverse<i128>, usize)>,
}

impl Pool {
    /// Without any bookings.
    pub fn unused(gaps: &Gaps) -> Self {
        Pool { gaps: gaps.clone(), overpaid: BTreeSet::new() }
    }

    pub fn new(problem: &Problem, members: &[usize], lanes: &[Lane]) -> Self {
        let mut pool = Pool::unused(&Gaps::new(&problem.looks));
        for &node in members {
            let gaps = lanes[node].gaps(i64::MIN, 0);
            gaps.for_each(|(start, end)| pool.gaps.insert(Gap { start, node, end }));
            pool.join(node, problem.nodes[node], &lanes[node]);
        }
        pool
    }

    pub fn gaps(&self) -> &Gaps {
        &self.gaps
    }

    /// Nodes billed in steps on which most is paid for unused time come first.
    pub fn overpaid(&self) -> impl Iterator<Item = usize> {
        self.overpaid.iter().map(|&(_, index)| index)
    }

    /// To be called before a node's bookings change.
    pub fn leave(&mut self, index: usize, node: &Node, lane: &Lane) {
        if !node.is_plainly_billed() {
            self.overpaid.remove(&(Reverse(lane.overpaid(node)), index));
        }
    }

    /// To be called after a node's bookings changed.
    pub fn join(&mut self, index: usize, node: &Node, lane: &Lane) {
        if !node.is_plainly_billed() && !lane.is_empty() {
            self.overpaid.insert((Reverse(lane.overpaid(node)), index));
        }
    }

    /// A booking splits a gap.
    pub fn split(&mut self, node: usize, (from, until): (i64, i64), (start, end): (i64, i64)) {
        self.gaps.remove(from, node);
        for (start, end) in [(from, start), (end, until)].into_iter().filter(|(start, end)| start < end) {
            self.gaps.insert(Gap { start, node, end });
        }
    }

    /// Without a booking, this becomes one gap.
    pub fn close(&mut self, node: usize, (from, until): (i64, i64), (start, end): (i64, i64)) {
        if from < start {
            self.gaps.remove(from, node);
        }
        if end < until {
            self.gaps.remove(end, node);
        }
        self.gaps.insert(Gap { start: from, node, end: until });
    }
}
