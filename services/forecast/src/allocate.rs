//! Samples per stratum: Neyman allocation in whole numbers, with a floor and a cap per stratum.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A stratum, as far as the allocation is concerned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Number of pixels, N_h. The stratum gets no more samples than this.
    pub size: u64,
    /// Expected standard deviation of the cost of its pixels, S_h ≥ 0, in a unit that all strata share.
    pub spread: f64,
    /// Least number of samples, if there are enough pixels and samples.
    pub floor: u64,
}

/// Divides `samples` over the strata so that the variance Σ N_h² S_h² / n_h of a stratified total is least.
///
/// Starts from the floors. Each further sample goes to the stratum with the greatest priority N_h S_h / √(n_h
/// (n_h + 1)) that is not full. This is the exact optimum in whole numbers (Wright 2012, "The equivalence of
/// Neyman optimum allocation for sampling and equal proportions for apportioning the U.S. House of
/// Representatives").
///
/// The result sums to `samples`, or to the number of pixels if less. Ties go to the greater
/// N_h / √(n_h (n_h + 1)), then the lower index. If samples do not suffice for the floors, they are dealt out
/// one by one in the order of N_h S_h.
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

/// The claim of a stratum to the next sample.
struct Bid {
    /// Whether the stratum varies and has no sample yet. Its first sample removes an infinite variance.
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
