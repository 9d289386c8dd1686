//! From bookings to rentals: when it is cheaper to keep a node between two frames.

use crate::calendar::Window;
use crate::model::{Node, Rental};

/// The cheapest rentals for these runs of frames within one window. Runs are sorted and do not touch.
///
/// Each rental covers neighbouring runs and the idle time between them. A rental begins with a set-up, which
/// needs time before its first run. Only the first rental of a warm window may begin with the window instead.
/// The caller ensures that one of the two is possible.
pub(crate) fn rentals(node: &Node, window: Window, runs: &[(i64, i64)]) -> Vec<Rental> {
    // `best[i]` pays for the first i runs: the cost, and the last rental.
    let mut best: Vec<(i64, Option<(usize, Rental)>)> = vec![(0, None)];
    for upto in 1..=runs.len() {
        let end = runs[upto - 1].1;
        let mut cheapest: Option<(i64, Option<(usize, Rental)>)> = None;
        for first in (0..upto).rev() {
            let rental = beginning(node, window, runs, first, end);
            if let Some(rental) = rental {
                let cost = best[first].0.saturating_add(rental.cost);
                if cheapest.as_ref().is_none_or(|(least, _)| cost < *least) {
                    cheapest = Some((cost, Some((first, rental))));
                }
            }
            // A rental only gets more expensive with more runs. Once it costs more than the best so far, it
            // never pays.
            let alone = node.price(end.saturating_sub(runs[first].0), false);
            if cheapest.as_ref().is_some_and(|(least, _)| alone > *least) {
                break;
            }
        }
        best.push(cheapest.unwrap_or((i64::MAX, None)));
    }
    let mut found = Vec::new();
    let mut at = runs.len();
    while let Some((first, rental)) = best[at].1 {
        found.push(rental);
        at = first;
    }
    found.reverse();
    found
}

/// The cheapest rental from run `first` to `end`. `None` if there is no time for its beginning.
fn beginning(node: &Node, window: Window, runs: &[(i64, i64)], first: usize, end: i64) -> Option<Rental> {
    let earliest = if first == 0 { window.start } else { runs[first - 1].1 };
    let rental = |start: i64, setup: bool| Rental {
        node: node.id,
        start,
        end,
        setup,
        cost: node.price(end.saturating_sub(start), setup),
    };
    let cold = runs[first]
        .0
        .checked_sub(node.setup)
        .filter(|&start| start >= earliest)
        .map(|start| rental(start, node.setup > 0 || node.setup_cost > 0));
    let warm = (first == 0 && window.warm).then(|| rental(window.start, false));
    match (cold, warm) {
        (Some(cold), Some(warm)) => Some(if warm.cost <= cold.cost { warm } else { cold }),
        (cold, warm) => cold.or(warm),
    }
}

/// Splits a cost in proportion to times. The parts add up to the cost.
pub(crate) fn shares(cost: i64, times: impl Iterator<Item = i64> + Clone) -> impl Iterator<Item = i64> {
    let total: i128 = times.clone().map(i128::from).sum();
    let mut before = 0i128;
    times.map(move |time| {
        let part = |upto: i128| if total == 0 { 0 } else { i128::from(cost).saturating_mul(upto) / total };
        let from = part(before);
        before += i128::from(time);
        // The difference of two rising parts of an `i64` is an `i64`.
        i64::try_from(part(before) - from).unwrap_or(i64::MAX)
    })
}

#[cfg(test)]
mod tests {
    use super::{rentals, shares};
    use crate::calendar::Window;
    use crate::model::Node;

    const HOUR: i64 = 3_600_000_000;

    fn node() -> Node {
        Node { price_per_hour: 1000, billing_step: HOUR, setup: HOUR / 4, setup_cost: 100, ..Node::default() }
    }

    fn found(node: &Node, warm: bool, runs: &[(i64, i64)]) -> Vec<(i64, i64, i64)> {
        let window = Window { start: 0, end: 100 * HOUR, warm };
        rentals(node, window, runs).iter().map(|r| (r.start, r.end, r.cost)).collect()
    }

    #[test]
    fn a_short_gap_is_kept_and_a_long_one_is_not() {
        let half = HOUR / 2;
        let short = [(HOUR, HOUR + half), (2 * HOUR, 2 * HOUR + half)];
        assert_eq!(found(&node(), false, &short), [(HOUR - HOUR / 4, 2 * HOUR + half, 2100)]);
        let long = [(HOUR, HOUR + half), (6 * HOUR, 6 * HOUR + half)];
        assert_eq!(
            found(&node(), false, &long),
            [(HOUR - HOUR / 4, HOUR + half, 1100), (6 * HOUR - HOUR / 4, 6 * HOUR + half, 1100)]
        );
    }

    #[test]
    fn a_warm_window_saves_the_set_up_where_that_is_cheaper() {
        assert_eq!(found(&node(), true, &[(HOUR / 4, HOUR)]), [(0, HOUR, 1000)]);
        assert_eq!(found(&node(), true, &[(9 * HOUR, 9 * HOUR + HOUR / 2)]).len(), 1);
        assert_eq!(found(&node(), true, &[(9 * HOUR, 9 * HOUR + HOUR / 2)])[0].0, 9 * HOUR - HOUR / 4);
    }

    #[test]
    fn a_gap_without_time_for_a_set_up_is_kept_whatever_it_costs() {
        let node = Node { setup: 5 * HOUR, ..node() };
        let runs = [(6 * HOUR, 7 * HOUR), (10 * HOUR, 11 * HOUR)];
        assert_eq!(found(&node, false, &runs), [(HOUR, 11 * HOUR, 10_100)]);
    }

    #[test]
    fn the_minimum_is_billed() {
        let node = Node { minimum_booking: 3 * HOUR, ..node() };
        assert_eq!(found(&node, false, &[(HOUR, 2 * HOUR)])[0].2, 3100);
    }

    #[test]
    fn shares_add_up_to_the_micro_unit() {
        let parts: Vec<i64> = shares(100, [1i64, 1, 1].into_iter()).collect();
        assert_eq!(parts, [33, 33, 34]);
        assert_eq!(shares(7, [i64::MAX, i64::MAX].into_iter()).sum::<i64>(), 7);
    }
}
