//! The allocation against every other allocation of the same samples.

use forelight_forecast::{Cell, allocate};
use proptest::prelude::*;

/// Σ N² S² / n, infinite where a stratum that varies has no sample.
fn variance(cells: &[Cell], allocation: &[u64]) -> f64 {
    cells
        .iter()
        .zip(allocation)
        .map(|(cell, &n)| {
            let spread = cell.size as f64 * cell.spread;
            if spread == 0.0 { 0.0 } else { spread * spread / n as f64 }
        })
        .sum()
}

/// Visits every allocation of `left` samples to the cells from `place` on, within floors and caps.
fn every(cells: &[Cell], place: usize, left: u64, current: &mut Vec<u64>, visit: &mut impl FnMut(&[u64])) {
    if place == cells.len() {
        if left == 0 {
            visit(current);
        }
        return;
    }
    let cell = &cells[place];
    for n in cell.floor.min(cell.size)..=cell.size.min(left) {
        current.push(n);
        every(cells, place + 1, left - n, current, visit);
        current.pop();
    }
}

fn cells(floor: u64) -> impl Strategy<Value = Vec<Cell>> {
    let spread = prop_oneof![1 => Just(0.0), 4 => 0.01f64..50.0];
    prop::collection::vec(
        (0u64..9, spread).prop_map(move |(size, spread)| Cell { size, spread, floor }),
        1..5,
    )
}

proptest! {
    #[test]
    fn the_greedy_allocation_is_the_optimum(cells in cells(1), extra in 0u64..12) {
        let floors: u64 = cells.iter().map(|c| c.floor.min(c.size)).sum();
        let pixels: u64 = cells.iter().map(|c| c.size).sum();
        let samples = (floors + extra).min(pixels);
        let found = allocate(&cells, samples);
        prop_assert_eq!(found.iter().sum::<u64>(), samples);
        let mut best = f64::INFINITY;
        every(&cells, 0, samples, &mut Vec::new(), &mut |other| best = best.min(variance(&cells, other)));
        prop_assert!(variance(&cells, &found) <= best * (1.0 + 1e-12));
    }

    #[test]
    fn samples_add_up_between_floor_and_cap(cells in cells(2), samples in 0u64..60) {
        let found = allocate(&cells, samples);
        let pixels: u64 = cells.iter().map(|c| c.size).sum();
        let floors: u64 = cells.iter().map(|c| c.floor.min(c.size)).sum();
        prop_assert_eq!(found.iter().sum::<u64>(), samples.min(pixels));
        for (cell, &n) in cells.iter().zip(&found) {
            prop_assert!(n <= cell.size);
            if samples >= floors {
                prop_assert!(n >= cell.floor.min(cell.size));
            } else {
                prop_assert!(n <= cell.floor);
            }
        }
    }
}

#[test]
fn equal_strata_are_served_from_the_lowest_index() {
    let cell = Cell { size: 10, spread: 1.0, floor: 1 };
    assert_eq!(allocate(&[cell; 4], 6), [2, 2, 1, 1]);
}

#[test]
fn with_more_strata_than_samples_the_weightiest_get_them() {
    let cell = |size, spread| Cell { size, spread, floor: 2 };
    let cells = [cell(10, 1.0), cell(1000, 1.0), cell(10, 500.0), cell(500, 1.0), cell(3, 1.0)];
    assert_eq!(allocate(&cells, 3), [0, 1, 1, 1, 0]);
}

#[test]
fn strata_that_do_not_vary_share_by_size() {
    let cell = |size| Cell { size, spread: 0.0, floor: 1 };
    assert_eq!(allocate(&[cell(900), cell(100)], 10), [9, 1]);
}

#[test]
fn spreads_that_are_no_numbers_count_as_none() {
    let cell = |spread| Cell { size: 50, spread, floor: 1 };
    let found = allocate(&[cell(f64::NAN), cell(f64::INFINITY), cell(-3.0), cell(1.0)], 20);
    assert_eq!(found, [1, 1, 1, 17]);
}

#[test]
fn no_strata_take_no_samples() {
    assert!(allocate(&[], 10).is_empty());
}
