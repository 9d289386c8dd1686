//! How many samples each stratum gets: Neyman's rule in whole numbers, with a floor and a cap.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A stratum as the allocation sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Pixels in the stratum, N_h: no more samples than this.
    pub size: u64,
    /// Expected standard deviation of the cost of its pixels, S_h ≥ 0, in any unit common to all strata.
    pub spread: f64,
    /// Samples that it gets first of all, as far as pixels and samples go.
    pub floor: u64,
}

/// Divides `samples` over the strata so that the variance Σ N_h² S_h² / n_h of a stratified total is least.
///
/// Starts from the floors and gives each next sample to the stratum of the greatest priority N_h S_h / √(n_h
/// (n_h + 1)), skipping full ones. That is the exact integer optimum, since the sample takes exactly the
/// square of its priority off the variance and the priorities of a stratum fall (Wright 2012, "The
/// equivalence of Neyman optimum allocation for sampling and equal proportions for apportioning the U.S.
/// House of Representatives").
///
/// The result sums to `samples`, or to the number of pixels if that is less. Equal priorities go to the
/// larger stratum by N_h / √(n_h (n_h + 1)), then to the lower index. If the samples do not reach the floors,
/// they are dealt out in rounds of one in the order of N_h S_h, so that the strata that matter most are not
/// left empty.
pub fn allocate(cells: &[Cell], samples: u64) -> Vec<u64> {
    let mut allocation = vec![0u64; cells.len()];
    let mut left = samples;
    let mut round = 0;
    while left > 0 {
        let mut short: Vec<Bid> = cells
            .iter()
            .enumerate()
            .filter(|(_, cell)| round < cell.floor.min(cell.size))
            .map(|(index, cell)| Bid::new(index, cell, 0))
            .collect();
        if short.is_empty() {
            break;
        }
        short.sort_unstable_by(|a, b| b.cmp(a));
        for bid in short.iter().take(usize::try_from(left).unwrap_or(usize::MAX)) {
            allocation[bid.index] += 1;
            left -= 1;
        }
        round += 1;
    }
    let bid = |index: usize, taken: u64| {
        let cell = &cells[index];
        (taken < cell.size).then(|| Bid::new(index, cell, taken))
    };
    let mut queue: BinaryHeap<Bid> =
        allocation.iter().enumerate().filter_map(|(index, &taken)| bid(index, taken)).collect();
    while left > 0
        && let Some(best) = queue.pop()
    {
        allocation[best.index] += 1;
        left -= 1;
        queue.extend(bid(best.index, allocation[best.index]));
    }
    allocation
}

/// A stratum's claim to the next sample.
struct Bid {
    /// Whether the stratum has none yet; the first sample takes away an infinite variance.
    empty: bool,
    priority: f64,
    by_size: f64,
    index: usize,
}

impl Bid {
    fn new(index: usize, cell: &Cell, taken: u64) -> Self {
        let divisor = if taken == 0 { 1.0 } else { libm::sqrt(taken as f64 * (taken as f64 + 1.0)) };
        let by_size = cell.size as f64 / divisor;
        let spread = if cell.spread.is_finite() { cell.spread.max(0.0) } else { 0.0 };
        Bid { empty: taken == 0 && spread > 0.0, priority: by_size * spread, by_size, index }
    }
}

impl Ord for Bid {
    fn cmp(&self, other: &Self) -> Ordering {
        self.empty
            .cmp(&other.empty)
            .then(self.priority.total_cmp(&other.priority))
            .then(self.by_size.total_cmp(&other.by_size))
            .then(other.index.cmp(&self.index))
    }
}

impl PartialOrd for Bid {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Bid {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Bid {}
