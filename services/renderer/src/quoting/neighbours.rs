//! Neighbours of profiled pixels, whose time is that of pixels in a render.
//!
//! A scattered pixel finds the scene's data outside of the processor's caches. In a render, its neighbours
//! have just used the same data. So a few blocks of neighbours are traced in one run each. The first pixels
//! of a block warm the caches, and the rest show the time.

use std::collections::BTreeSet;

/// Profiled pixels per block. Beyond the square of this, the number of blocks grows with the square root of
/// pixels. A dozen blocks give a reliable mean, and they are the most expensive part of a profile.
const PICKS_PER_SITE: usize = 16;
/// Edge of the block of neighbours, pixels.
const BLOCK: u32 = 8;
/// Share of a block's pixels that only warm the caches.
pub const WARMING_SHARE: f64 = 0.5;

/// Number of blocks for so many profiled pixels.
pub fn sites(picks: usize) -> usize {
    (picks / PICKS_PER_SITE).min(picks.isqrt())
}

/// Mean of the middle half, NaN if empty. Leaves out blocks whose thread was interrupted.
pub fn middle_mean(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let quarter = values.len() / 4;
    let middle = &values[quarter..values.len() - quarter];
    middle.iter().sum::<f64>() / middle.len() as f64
}

/// Indices drawn systematically in proportion to `sizes`, ascending and distinct.
pub fn proportional_sites(sizes: &[f64], wanted: usize) -> Vec<usize> {
    let step = sizes.iter().sum::<f64>() / wanted as f64;
    let mut sites = Vec::with_capacity(wanted);
    let (mut passed, mut next) = (0.0, 0.5 * step);
    for (index, size) in sizes.iter().enumerate() {
        passed += size;
        if passed > next && sites.len() < wanted {
            sites.push(index);
            next += step * ((passed - next) / step).floor().max(0.0) + step;
        }
    }
    sites
}

/// Unfinished pixels of the block around a pixel, row by row.
pub fn free_neighbours(pixel: u32, width: u32, height: u32, taken: &BTreeSet<u32>) -> Vec<u32> {
    let first = |at: u32, size: u32| (at / BLOCK * BLOCK).min(size.saturating_sub(BLOCK));
    let (x0, y0) = (first(pixel % width, width), first(pixel / width, height));
    let row = |y: u32| (x0..width.min(x0 + BLOCK)).map(move |x| y * width + x);
    (y0..height.min(y0 + BLOCK)).flat_map(row).filter(|pixel| !taken.contains(pixel)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_disturbed_block_does_not_count() {
        assert_eq!(middle_mean(vec![1.0, 1.2, 0.8, 90.0]), 1.1);
        assert_eq!(middle_mean(vec![3.0]), 3.0);
        assert!(middle_mean(Vec::new()).is_nan());
    }

    #[test]
    fn four_times_the_pixels_take_twice_the_blocks_once_there_are_enough() {
        assert_eq!([0, 15, 64, 256, 1024, 4096].map(sites), [0, 0, 4, 16, 32, 64]);
    }

    #[test]
    fn sites_are_where_the_work_is() {
        assert_eq!(proportional_sites(&[1.0; 8], 4), [0, 2, 4, 6].map(|i| i + 1));
        let mut sizes = vec![1.0; 100];
        sizes[70] = 300.0;
        let sites = proportional_sites(&sizes, 8);
        assert!(sites.contains(&70) && sites.len() < 8, "{sites:?}");
        assert_eq!(proportional_sites(&[], 4), [0; 0]);
        assert_eq!(proportional_sites(&[1.0, 2.0], 0), [0; 0]);
        assert_eq!(proportional_sites(&[0.0, 0.0], 2), [0; 0]);
    }

    #[test]
    fn neighbours_are_inside_the_image_and_not_finished_already() {
        let taken = BTreeSet::from([5 * 20 + 9, 99, 11 * 20 + 15]);
        let free = |pixel, width, height| free_neighbours(pixel, width, height, &taken);
        // Column 13 and row 9 of 20 × 12: the block of columns 8 to 15, moved up to rows 4 to 11.
        let rows = (4..12).flat_map(|y| (8..16).map(move |x| y * 20 + x));
        let expected: Vec<u32> = rows.filter(|pixel| ![109, 235].contains(pixel)).collect();
        assert_eq!(free(9 * 20 + 13, 20, 12), expected);
        assert_eq!(free(0, 1, 1), [0]);
        assert_eq!(free(11, 4, 3), (0..12).collect::<Vec<u32>>());
    }
}
