use std::collections::BTreeMap;

use super::violation::Violation;
use crate::model::{Booking, Input, Interval, Node, Power, Rental};

/// Bookings do not overlap, and lie in the calendar.
pub(super) fn check_node(
    input: &Input,
    node: &Node,
    bookings: &[Booking],
    fixed: &[(i64, i64)],
    found: &mut Vec<Violation>,
) {
    let open = sorted(&node.calendar);
    let mut busy_until = i64::MIN;
    for &booking in bookings {
        if !is_open(input, node, &open, booking.start, booking.end) {
            found.push(Violation::Calendar(booking));
        }
        if booking.start >= booking.end {
            continue;
        }
        let with_fixed = fixed.iter().any(|&(start, end)| start < booking.end && booking.start < end);
        if booking.start < busy_until || with_fixed {
            found.push(Violation::Overlap(booking));
        }
        busy_until = busy_until.max(booking.end);
    }
}

fn sorted(calendar: &[Interval]) -> Vec<Interval> {
    let mut open = calendar.to_vec();
    open.sort_unstable_by_key(|interval| interval.start);
    open
}

/// Whether calendar and maintenance allow the time from `start` to just before `end`.
fn is_open(input: &Input, node: &Node, open: &[Interval], start: i64, end: i64) -> bool {
    let closed = node.maintenance.iter().any(|closed| {
        let until = closed.end.unwrap_or(i64::MAX);
        closed.start < until && closed.start < end && start < until
    });
    start >= node.available_from.max(input.now) && !closed && covered(open, start, end)
}

/// Whether the intervals, sorted by start, cover all time from `start` to `end`.
fn covered(open: &[Interval], start: i64, end: i64) -> bool {
    let mut reached = start;
    for interval in open {
        if reached >= end || interval.start > reached {
            break;
        }
        match interval.end {
            None => return true,
            Some(until) => reached = reached.max(until),
        }
    }
    reached >= end
}

/// Every booking is paid for and every rental valid. Adds the rentals' cost to the jobs.
pub(super) fn check_rentals(
    input: &Input,
    node: &Node,
    bookings: &[Booking],
    mut rentals: Vec<Rental>,
    fixed: &[(i64, i64)],
    costs: &mut BTreeMap<u64, i128>,
    found: &mut Vec<Violation>,
) {
    rentals.sort_unstable_by_key(|rental| (rental.start, rental.end));
    let open = sorted(&node.calendar);
    let mut paid_until = i64::MIN;
    let mut paid = vec![false; bookings.len()];
    for &rental in &rentals {
        let mut wrong = |wrong| found.push(Violation::Rental { rental, wrong });
        if rental.start < paid_until {
            wrong("overlaps another rental");
        }
        paid_until = paid_until.max(rental.end);
        let taken = fixed.iter().any(|&(start, end)| start < rental.end && rental.start < end);
        if taken || !is_open(input, node, &open, rental.start, rental.end) {
            wrong("is outside the node's free time");
        }
        let ready = if rental.setup { rental.start.saturating_add(node.setup) } else { rental.start };
        let runs_already = (node.power == Power::On && rental.start == node.available_from.max(input.now))
            || fixed.iter().any(|&(_, end)| end == rental.start);
        if !rental.setup && !runs_already && (node.setup > 0 || node.setup_cost > 0) {
            wrong("begins without a set-up");
        }
        if rental.cost != node.price(rental.end.saturating_sub(rental.start), rental.setup) {
            wrong("has the wrong cost");
        }
        let first = bookings.partition_point(|booking| booking.start < ready);
        let beyond = bookings.partition_point(|booking| booking.start < rental.end).max(first);
        let within = &bookings[first..beyond];
        if within.iter().map(|booking| booking.end).max() != Some(rental.end) {
            wrong("does not end with a booking");
        }
        paid[first..beyond].iter_mut().for_each(|paid| *paid = true);
        let total: i128 = within.iter().map(length).sum();
        let mut before = 0;
        for booking in within {
            let upto = before + length(booking);
            let part = |time: i128| i128::from(rental.cost).saturating_mul(time) / total.max(1);
            *costs.entry(booking.job).or_default() += part(upto) - part(before);
            before = upto;
        }
    }
    let unpaid = bookings.iter().zip(paid).filter(|(_, paid)| !paid);
    found.extend(unpaid.map(|(&booking, _)| Violation::NotRented(booking)));
}

fn length(booking: &Booking) -> i128 {
    i128::from(booking.end) - i128::from(booking.start)
}
