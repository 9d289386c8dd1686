//! One node's time while a plan is made: free time, bookings and their cost.

use crate::admission::IN_A_MICRO_UNIT;
use crate::calendar::Window;
use crate::intervals::Intervals;
use crate::model::{Node, Rental, price_of};
use crate::rental::rentals;

/// The most gaps tried on a node that is not plainly billed. The first is the earliest; later ones may hold
/// time that is already paid for.
const GAPS_TRIED: usize = 3;

#[derive(Clone, Debug)]
pub(crate) struct Lane {
    is_plain: bool,
    stretches: Vec<Stretch>,
    /// Time for bookings: after the set-up, and not booked.
    free: Intervals,
    used: i64,
    /// Cost of the rentals. Not kept for plainly billed nodes.
    cost: i128,
}

#[derive(Clone, Debug)]
struct Stretch {
    window: Window,
    /// Bookings. Those that touch are joined.
    runs: Intervals,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted {
    pub release: i64,
    pub latest_end: i64,
    pub duration: i64,
}

/// Which matters more, the end or the cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Prefer {
    Early,
    Cheap,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fit {
    pub start: i64,
    pub end: i64,
    pub added_cost: i64,
    /// For scarce time: what is left of the gap behind it.
    pub left: i64,
    /// What others would pay for this time; see [`worth`](crate::admission::Admission::worth).
    pub worth: i128,
}

impl Fit {
    /// Orders places. Less is better.
    pub fn rank(&self, prefer: Prefer) -> (i128, i64, i64) {
        match prefer {
            Prefer::Early => (i128::from(self.end), self.added_cost, 0),
            Prefer::Cheap => {
                let cost = i128::from(self.added_cost) * IN_A_MICRO_UNIT;
                (cost.saturating_add(self.worth), self.left, self.end)
            }
        }
    }
}

impl Lane {
    pub fn new(node: &Node, windows: &[Window]) -> Self {
        let free = Intervals::union(windows.iter().map(|window| (window.ready(node), window.end)).collect());
        Lane {
            is_plain: node.is_plainly_billed(),
            free,
            stretches: windows.iter().map(|&window| Stretch { window, runs: Intervals::default() }).collect(),
            used: 0,
            cost: 0,
        }
    }

    pub fn is_empty(&self) -> bool {
        self.used == 0
    }

    /// On a node billed in steps: what is paid beyond the price of the booked time.
    pub fn overpaid(&self, node: &Node) -> i128 {
        self.cost - i128::from(price_of(node.price_per_hour, self.used))
    }

    /// On a node billed in steps: the least that a booking of this length adds to the cost, wherever it is.
    pub fn least_added_cost(&self, node: &Node, duration: i64) -> i64 {
        let least = i128::from(price_of(node.price_per_hour, self.used.saturating_add(duration)));
        within_money(least - self.cost).max(0)
    }

    /// The earliest place for a booking.
    pub fn first(&self, wanted: &Wanted) -> Option<(i64, i64)> {
        self.free.long_after(wanted.release, wanted.duration).find_map(|gap| within(gap, wanted))
    }

    /// The place that adds least to the cost, with what others would pay for the time. Ties go to the
    /// earliest.
    pub fn cheapest(&self, node: &Node, wanted: &Wanted, worth: impl Fn(i64, i64) -> i128) -> Option<Fit> {
        let mut best: Option<Fit> = None;
        let gaps = self.free.long_after(wanted.release, wanted.duration);
        for gap in gaps.take_while(|gap| gap.0 < wanted.latest_end).take(GAPS_TRIED) {
            let Some((start, end)) = within(gap, wanted) else { continue };
            let mut consider = |start: i64, end: i64| {
                let added_cost = self.added_cost(node, start, end);
                let fit = Fit { start, end, added_cost, left: 0, worth: worth(start, end) };
                if best.is_none_or(|best| fit.rank(Prefer::Cheap) < best.rank(Prefer::Cheap)) {
                    best = Some(fit);
                }
            };
            consider(start, end);
            // Just before the next booking, it may need no rental of its own.
            let late_start = gap.1.saturating_sub(wanted.duration);
            let is_followed = gap.1 < self.stretches[self.stretch_at(start)].window.end;
            if is_followed && gap.1 <= wanted.latest_end && late_start > start {
                consider(late_start, gap.1);
            }
            if best.is_some_and(|best| best.added_cost == 0 && best.worth == 0) {
                break;
            }
        }
        best
    }

    /// Gaps that end after this instant and are at least this long.
    pub fn gaps(&self, after: i64, least: i64) -> impl Iterator<Item = (i64, i64)> {
        self.free.long_after(after, least)
    }

    /// What a booking adds to the cost of the rentals.
    pub fn added_cost(&self, node: &Node, start: i64, end: i64) -> i64 {
        if self.is_plain {
            return price_of(node.price_per_hour, end.saturating_sub(start));
        }
        within_money(self.stretches[self.stretch_at(start)].added_cost(node, start, end))
    }

    /// The free time that holds this instant or follows it.
    pub fn gap(&self, instant: i64) -> Option<(i64, i64)> {
        self.free.around(instant).1
    }

    pub fn is_free(&self, start: i64, end: i64) -> bool {
        self.free.contains(start, end)
    }

    /// The unbroken time without this booking: the free time before it, its own, and the free time behind it.
    pub fn room_without(&self, start: i64, end: i64) -> (i64, i64) {
        let (before, behind) = self.free.around(start);
        let before = before.filter(|gap| gap.1 == start);
        let behind = behind.filter(|gap| gap.0 == end);
        (before.map_or(start, |gap| gap.0), behind.map_or(end, |gap| gap.1))
    }

    pub fn book(&mut self, node: &Node, start: i64, end: i64) {
        self.free.take(start, end);
        self.used = self.used.saturating_add(end.saturating_sub(start));
        let at = self.stretch_at(start);
        let stretch = &mut self.stretches[at];
        if !self.is_plain {
            self.cost += stretch.added_cost(node, start, end);
        }
        stretch.runs.give(start, end);
    }

    pub fn unbook(&mut self, node: &Node, start: i64, end: i64) {
        let at = self.stretch_at(start);
        let stretch = &mut self.stretches[at];
        if !stretch.runs.contains(start, end) {
            return;
        }
        stretch.runs.take(start, end);
        if !self.is_plain {
            self.cost -= stretch.added_cost(node, start, end);
        }
        self.free.give(start, end);
        self.used = self.used.saturating_sub(end.saturating_sub(start));
    }

    /// What releasing this booking would save.
    pub fn saved_without(&self, node: &Node, start: i64, end: i64) -> i64 {
        self.added_cost(node, start, end)
    }

    pub fn rentals(&self, node: &Node) -> Vec<Rental> {
        let mut all = Vec::new();
        for stretch in &self.stretches {
            if self.is_plain {
                all.extend(stretch.runs.iter().map(|(start, end)| Rental {
                    node: node.id,
                    start,
                    end,
                    setup: false,
                    cost: node.price(end.saturating_sub(start), false),
                }));
            } else {
                all.extend(rentals(node, stretch.window, &stretch.runs.iter().collect::<Vec<_>>()));
            }
        }
        all
    }

    fn stretch_at(&self, instant: i64) -> usize {
        self.stretches.partition_point(|stretch| stretch.window.end <= instant)
    }
}

impl Stretch {
    /// What a booking adds to the cost of the rentals, whether it is there already or not. Only nearby
    /// rentals are computed again: no rental spans a gap that is too long to pay for, so the sides of such
    /// a gap do not affect each other.
    fn added_cost(&self, node: &Node, start: i64, end: i64) -> i128 {
        let own = self.runs.around(start).1.filter(|run| run.0 < end).unwrap_or((start, end));
        let mut near: Vec<(i64, i64)> = Vec::new();
        let (mut from, mut until) = (start, end);
        let mut before = if own.0 < start { Some((own.0, start)) } else { self.runs.before(start) };
        while let Some(run) = before
            && (self.window.warm || !never_pays(node, from.saturating_sub(run.1)))
        {
            near.push(run);
            from = run.0;
            before = self.runs.before(run.0);
        }
        near.reverse();
        let rest = Some((end, own.1)).filter(|_| end < own.1);
        for run in rest.into_iter().chain(self.runs.after(own.1)) {
            if never_pays(node, run.0.saturating_sub(until)) {
                break;
            }
            near.push(run);
            until = until.max(run.1);
        }
        let window =
            before.map_or(self.window, |(_, start)| Window { start, end: self.window.end, warm: false });
        let was = total(&rentals(node, window, &near));
        total(&rentals(node, window, &joined(&near, start, end))) - was
    }
}

/// Whether two rentals are never more expensive than one across a gap of this length. The gap must cost more
/// than both can lose to steps, minima, a set-up and rounding.
fn never_pays(node: &Node, gap: i64) -> bool {
    let lost =
        node.billing_step.saturating_add(node.minimum_booking).saturating_mul(2).saturating_add(node.setup);
    gap > lost && price_of(node.price_per_hour, gap - lost) > node.setup_cost.saturating_add(2)
}

/// The earliest suitable time in the gap.
fn within(gap: (i64, i64), wanted: &Wanted) -> Option<(i64, i64)> {
    let start = gap.0.max(wanted.release);
    let end = start.checked_add(wanted.duration)?;
    (end <= gap.1 && end <= wanted.latest_end).then_some((start, end))
}

/// Adds a booking that overlaps no run.
fn joined(runs: &[(i64, i64)], start: i64, end: i64) -> Vec<(i64, i64)> {
    let at = runs.partition_point(|run| run.1 < start);
    let mut new = (start, end);
    let mut beyond = at;
    while let Some(run) = runs.get(beyond).filter(|run| run.0 <= end) {
        new = (new.0.min(run.0), new.1.max(run.1));
        beyond += 1;
    }
    let mut all = Vec::with_capacity(runs.len() + 1);
    all.extend_from_slice(&runs[..at]);
    all.push(new);
    all.extend_from_slice(&runs[beyond..]);
    all
}

fn total(rentals: &[Rental]) -> i128 {
    rentals.iter().map(|rental| i128::from(rental.cost)).sum()
}

/// Saturates at the range of money.
fn within_money(amount: i128) -> i64 {
    amount.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
}

#[cfg(test)]
mod tests {
    use super::{Fit, Lane, Wanted};
    use crate::calendar::Window;
    use crate::model::Node;

    const HOUR: i64 = 3_600_000_000;

    fn wanted(release: i64, duration: i64) -> Wanted {
        Wanted { release, latest_end: i64::MAX, duration }
    }

    fn lane(node: &Node, windows: &[(i64, i64)]) -> Lane {
        let windows: Vec<Window> =
            windows.iter().map(|&(start, end)| Window { start, end, warm: false }).collect();
        Lane::new(node, &windows)
    }

    #[test]
    fn a_stretch_must_fit_into_one_gap() {
        let node = Node { id: 1, ..Node::default() };
        let lane = lane(&node, &[(0, 10), (20, 40)]);
        let at = |release, duration| lane.first(&wanted(release, duration)).map(|(start, _)| start);
        assert_eq!(at(0, 10), Some(0));
        assert_eq!(at(1, 10), Some(20));
        assert_eq!(at(30, 10), Some(30));
        assert_eq!(at(31, 10), None);
        assert_eq!(at(0, i64::MAX), None);
    }

    #[test]
    fn time_that_is_paid_already_costs_nothing_more() {
        let node = Node { price_per_hour: 1000, billing_step: HOUR, ..Node::default() };
        let mut lane = lane(&node, &[(0, 100 * HOUR)]);
        lane.book(&node, 0, HOUR / 2);
        let half = lane.cheapest(&node, &wanted(0, HOUR / 2), |_, _| 0);
        assert_eq!(half, Some(Fit { start: HOUR / 2, end: HOUR, added_cost: 0, left: 0, worth: 0 }));
        assert_eq!(lane.least_added_cost(&node, HOUR / 2), 0);
        assert_eq!(lane.least_added_cost(&node, HOUR), 500);
        lane.book(&node, HOUR / 2, HOUR);
        assert_eq!(lane.saved_without(&node, 0, HOUR / 2), 0, "the hour is billed all the same");
        lane.unbook(&node, 0, HOUR / 2);
        lane.unbook(&node, HOUR / 2, HOUR);
        assert!(lane.rentals(&node).is_empty() && lane.is_free(0, 100 * HOUR));
    }

    #[test]
    fn what_a_booking_adds_is_what_all_rentals_cost_more_with_it() {
        use crate::chance::between;
        for seed in 0..300 {
            let draw = |n: u64, low, high| between(seed, &[n], low, high);
            let node = Node {
                price_per_hour: draw(0, 0, 3) * 1000,
                billing_step: draw(1, 1, 3) * HOUR / 4,
                minimum_booking: draw(2, 0, 2) * HOUR / 3,
                setup: draw(3, 0, 2) * HOUR / 4,
                setup_cost: draw(4, 0, 2) * 200,
                ..Node::default()
            };
            let window = Window { start: 0, end: 200 * HOUR, warm: draw(5, 0, 1) == 1 };
            let mut lane = Lane::new(&node, &[window]);
            let mut booked: Vec<(i64, i64)> = Vec::new();
            for n in 0..20 {
                let start = HOUR + draw(10 + n, 0, 60) * HOUR / 4;
                let end = start + draw(40 + n, 1, 12) * HOUR / 4;
                if lane.is_free(start, end) {
                    lane.book(&node, start, end);
                    booked.push((start, end));
                    assert_eq!(lane.cost, super::total(&lane.rentals(&node)), "seed {seed}, booking {n}");
                }
                if draw(80 + n, 0, 2) == 0 && !booked.is_empty() {
                    let (start, end) = booked.swap_remove(n as usize % booked.len());
                    let saved = lane.saved_without(&node, start, end);
                    let before = lane.cost;
                    lane.unbook(&node, start, end);
                    assert_eq!(before - lane.cost, i128::from(saved));
                    assert_eq!(lane.cost, super::total(&lane.rentals(&node)), "seed {seed}, booking {n}");
                }
            }
        }
    }

    #[test]
    fn nothing_starts_before_the_set_up_is_done() {
        let node = Node { setup: 5, ..Node::default() };
        let lane = lane(&node, &[(0, 8), (10, 30)]);
        assert_eq!(lane.first(&wanted(0, 4)), Some((15, 19)));
    }
}
