//! Rentals: from a node's first task until it is idle at the end of the time that is billed anyway.

use std::cmp::Reverse;

use super::{Event, Farm, OpenRental};
use crate::record::Rented;

impl Farm<'_> {
    /// Idle nodes stay rented to the end of the time that is billed anyway.
    pub(super) fn settle(&mut self) {
        for node in std::mem::take(&mut self.freed) {
            if self.nodes[node].running.is_some() {
                continue;
            }
            if let Some(until) = self.paid_until(node) {
                if until <= self.now {
                    self.close_rental(node);
                } else {
                    self.events.push(Reverse((until, Event::Paid { node })));
                }
            }
        }
    }

    fn paid_until(&self, node: usize) -> Option<i64> {
        let rental = self.nodes[node].rental?;
        let worked = self.nodes[node].worked_until.saturating_sub(rental.start);
        Some(rental.start.saturating_add(self.node(node).billed(worked)))
    }

    pub(super) fn stop_paying(&mut self, node: usize) {
        let is_over = self.paid_until(node).is_some_and(|until| until <= self.now);
        if is_over && self.nodes[node].running.is_none() {
            self.close_rental(node);
        }
    }

    pub(super) fn close_rental(&mut self, node: usize) {
        let Some(OpenRental { start, setup }) = self.nodes[node].rental.take() else { return };
        let machine = self.node(node);
        let end = self.nodes[node].worked_until.max(start);
        let cost = machine.price(end.saturating_sub(start), setup);
        self.record.rentals.push(Rented { node: machine.id, start, end, setup, cost });
    }
}
