//! One pixel in each cell of a grid: at its centre, or at random.

use super::image::Image;
use crate::random::{below, hash};

/// Largest aspect ratio of a cell.
const LONGEST: f64 = 2.0;

/// Columns and rows of at most `samples` cells: as many as possible, then as square as possible.
fn grid(image: Image, samples: u32) -> (u32, u32) {
    let candidates = (1..=image.width.min(samples)).map(|columns| {
        let rows = (samples / columns).min(image.height);
        let shape = f64::from(image.width) / f64::from(columns) * f64::from(rows) / f64::from(image.height);
        (columns, rows, shape.max(1.0 / shape))
    });
    let better = |a: &(u32, u32, f64), b: &(u32, u32, f64)| {
        let (square_a, square_b) = (a.2 <= LONGEST, b.2 <= LONGEST);
        let (cells_a, cells_b) = (u64::from(a.0) * u64::from(a.1), u64::from(b.0) * u64::from(b.1));
        square_a.cmp(&square_b).then(cells_a.cmp(&cells_b)).then(b.2.total_cmp(&a.2))
    };
    candidates.max_by(better).map_or((0, 0), |(columns, rows, _)| (columns, rows))
}

/// The cells row by row, alternately to the right and to the left, so that successive cells are neighbours.
fn serpentine(columns: u32, rows: u32) -> impl Iterator<Item = (u32, u32)> {
    let column = move |row: u32, step: u32| if row.is_multiple_of(2) { step } else { columns - 1 - step };
    (0..rows).flat_map(move |row| (0..columns).map(move |step| (column(row, step), row)))
}

/// Pixel at the fraction (`cell` + `within` / 2³²) / `cells` of `length`. `within` must be below 2³².
fn along(length: u32, cells: u32, cell: u32, within: u64) -> u32 {
    let fraction = (u128::from(cell) << 32) | u128::from(within);
    ((fraction * u128::from(length) / u128::from(cells)) >> 32) as u32
}

/// The paper's strategy 1: the centre of every cell. `shift` moves all points modulo their cells, in units of
/// 2⁻³² of a cell.
pub(super) fn regular(image: Image, samples: u32, shift: [u32; 2]) -> Vec<u32> {
    const CENTRE: u32 = 1 << 31;
    let (columns, rows) = grid(image, samples);
    let [dx, dy] = shift.map(|shift| u64::from(CENTRE.wrapping_add(shift)));
    serpentine(columns, rows)
        .map(|(column, row)| {
            along(image.height, rows, row, dy) * image.width + along(image.width, columns, column, dx)
        })
        .collect()
}

/// The paper's strategy 2: a random pixel of every cell. `counters` are the counters of the random numbers.
pub(super) fn jittered(image: Image, samples: u32, counters: [u64; 2]) -> Vec<u32> {
    let (columns, rows) = grid(image, samples);
    let [seed, frame] = counters;
    let within = |length: u32, cells: u32, cell: u32, axis: u64, other: u32| {
        let (from, to) = (along(length, cells, cell, 0), along(length, cells, cell + 1, 0));
        let number = hash(&[seed, frame, axis, u64::from(cell), u64::from(other)]);
        from + below(number, u64::from(to - from)) as u32
    };
    serpentine(columns, rows)
        .map(|(column, row)| {
            let x = within(image.width, columns, column, 0, row);
            let y = within(image.height, rows, row, 1, column);
            y * image.width + x
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: Image = Image { width: 256, height: 256 };

    #[test]
    fn the_papers_grid_is_the_centres_of_sixteen_by_sixteen_cells() {
        let mut found = regular(PAPER, 256, [0, 0]);
        found.sort_unstable();
        let expected: Vec<u32> = (0..16)
            .flat_map(|row| (0..16).map(move |column| (16 * row + 8) * 256 + 16 * column + 8))
            .collect();
        assert_eq!(found, expected);
    }

    #[test]
    fn every_cell_has_one_jittered_pixel_and_any_pixel_of_it_may_be_it() {
        let mut seen = vec![false; 16 * 16];
        for seed in 0..4000 {
            let cells: Vec<u32> = jittered(PAPER, 256, [seed, 0])
                .into_iter()
                .map(|pixel| pixel / 256 / 16 * 16 + pixel % 256 / 16)
                .collect();
            let expected: Vec<u32> = serpentine(16, 16).map(|(column, row)| row * 16 + column).collect();
            assert_eq!(cells, expected);
            let first = jittered(PAPER, 256, [seed, 0])[0];
            seen[(first / 256 * 16 + first % 256) as usize] = true;
        }
        assert!(seen.into_iter().all(|seen| seen));
    }

    #[test]
    fn cells_are_as_many_as_can_be_and_close_to_square() {
        assert_eq!(grid(PAPER, 512), (32, 16));
        assert_eq!(grid(Image { width: 192, height: 108 }, 256), (16, 16));
        assert_eq!(grid(Image { width: 100, height: 2 }, 120), (60, 2));
        assert_eq!(grid(Image { width: 5, height: 7 }, 35), (5, 7));
        assert_eq!(grid(PAPER, 0), (0, 0));
    }

    #[test]
    fn a_shifted_grid_stays_within_its_cells_and_has_every_pixel_once() {
        let image = Image { width: 37, height: 23 };
        for shift in [[0, 0], [1 << 31, 3 << 30], [u32::MAX, 77]] {
            let mut found = regular(image, 60, shift);
            let count = found.len();
            found.sort_unstable();
            found.dedup();
            assert_eq!(found.len(), count);
            assert!(found.iter().all(|&pixel| pixel < 37 * 23));
        }
    }
}
