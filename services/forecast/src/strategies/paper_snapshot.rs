//! The paper's Snapshot strategy: pixels spread over the objects of the ID preview.

use super::uniform::choose;
use crate::allocate::{Cell, allocate};
use crate::frame_design::Pick;

/// The picks of the paper's strategy 7. The paper wants "as many different object and material pairs as
/// possible" to have a profiled pixel, and says no more. So every pair gets one pixel, largest first, and the
/// rest is divided by size.
pub(super) fn picks(counts: &[u32], stratum_ids: &[u32], samples: u32, [seed, frame]: [u64; 2]) -> Vec<Pick> {
    let cells: Vec<Cell> =
        counts.iter().map(|&size| Cell { size: size.into(), spread: 1.0, floor: 1 }).collect();
    let mut lists: Vec<Vec<u32>> = counts.iter().map(|&size| Vec::with_capacity(size as usize)).collect();
    for (pixel, &stratum) in (0u32..).zip(stratum_ids) {
        lists[stratum as usize].push(pixel);
    }
    let allocation = allocate(&cells, samples.into());
    let drawn = lists.into_iter().zip(allocation).zip(0u32..);
    drawn
        .flat_map(|((list, wanted), stratum)| {
            let pixels = choose(list, wanted as usize, [seed, frame, stratum.into()]);
            pixels.into_iter().map(move |pixel| Pick { pixel, stratum })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::picks;

    #[test]
    fn every_object_gets_a_pixel_and_the_wall_the_rest() {
        let ids: Vec<u32> = (0..1000).map(|pixel| if pixel < 990 { 0 } else { pixel - 989 }).collect();
        let mut counts = vec![1; 11];
        counts[0] = 990;
        let found = picks(&counts, &ids, 30, [1, 0]);
        let of = |stratum| found.iter().filter(|pick| pick.stratum == stratum).count();
        assert_eq!(of(0), 20);
        assert!((1..=10).all(|stratum| of(stratum) == 1));
        assert!(found.iter().all(|pick| ids[pick.pixel as usize] == pick.stratum));
    }

    #[test]
    fn with_more_objects_than_samples_the_largest_are_profiled() {
        let ids: Vec<u32> = [vec![0; 1], vec![1; 5], vec![2; 3], vec![3; 9]].concat();
        let mut strata: Vec<u32> =
            picks(&[1, 5, 3, 9], &ids, 2, [0, 0]).iter().map(|pick| pick.stratum).collect();
        strata.sort_unstable();
        assert_eq!(strata, [1, 3]);
    }
}
