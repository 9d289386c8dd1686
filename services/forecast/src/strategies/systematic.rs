//! A systematic sample: every k-th pixel along one order of all pixels.
//!
//! Successive pixels have the same material, the same object, or are neighbours along a curve, so they cost
//! alike. Every stretch of the order gets its share to within one pixel (implicit stratification: Cochran
//! 1977, chapter 8). The only strata are a few classes of expected cost, which set the density.

use super::image::Image;
use crate::allocate::{Cell, allocate};
use crate::frame_design::Pick;
use crate::hilbert::{hilbert, order_for};
use crate::random::hash;
use crate::strata::Stratum;

/// The classes of expected cost, ascending: one stratum per class, and the class of every input stratum.
pub(super) fn classes(strata: &[Stratum]) -> (Vec<Stratum>, Vec<u32>) {
    let mut costs: Vec<f64> = strata.iter().map(|stratum| stratum.prior_cost).collect();
    costs.sort_unstable_by(f64::total_cmp);
    costs.dedup();
    let of = strata.iter().map(|stratum| costs.partition_point(|&cost| cost < stratum.prior_cost) as u32);
    let of = of.collect();
    let class = |(index, prior_cost): (u32, f64)| Stratum {
        object: index,
        material: index,
        prior_cost,
        apart: false,
    };
    ((0u32..).zip(costs).map(class).collect(), of)
}

/// Sort key of a pixel in its class: material, object, stratum, position along the curve; and the pixel.
type Place = (u32, u32, u32, u64, u32);

/// Least number of samples in each class. Two are needed for a variance.
const FLOOR: u64 = 2;

/// The picks, class by class in its order, evenly spaced from a random start. Samples are allocated by pixels
/// times expected cost.
pub(super) fn picks(
    strata: &[Stratum],
    counts: &[u32],
    stratum_ids: &[u32],
    image: Image,
    samples: u32,
    [seed, frame]: [u64; 2],
) -> Vec<Pick> {
    let (list, of) = classes(strata);
    let curve = order_for(image.width, image.height);
    let mut orders: Vec<Vec<Place>> = vec![Vec::new(); list.len()];
    for (pixel, &id) in (0u32..).zip(stratum_ids) {
        let Stratum { object, material, .. } = strata[id as usize];
        let place = hilbert(curve, pixel % image.width, pixel / image.width);
        orders[of[id as usize] as usize].push((material, object, id, place, pixel));
    }
    let sizes = counts.iter().zip(&of).fold(vec![0u64; list.len()], |mut sizes, (&n, &class)| {
        sizes[class as usize] += u64::from(n);
        sizes
    });
    let cell = |(class, &size): (&Stratum, &u64)| Cell { size, spread: class.prior_cost, floor: FLOOR };
    let cells: Vec<Cell> = list.iter().zip(&sizes).map(cell).collect();
    let mut picks = Vec::with_capacity(samples as usize);
    for ((stratum, mut order), wanted) in (0u32..).zip(orders).zip(allocate(&cells, samples.into())) {
        order.sort_unstable();
        let start = hash(&[seed, frame, stratum.into()]);
        // Steps are at least one pixel long, so no pixel is picked twice.
        picks.extend((0..wanted).map(|step| {
            let fraction = (u128::from(step) << 64) | u128::from(start);
            // Fewer than 2³² samples and pixels, in units of 2⁻⁶⁴: the product stays below 2¹²⁸.
            let place = (fraction * order.len() as u128 / u128::from(wanted)) >> 64;
            Pick { pixel: order[place as usize].4, stratum }
        }));
    }
    picks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stratum(object: u32, material: u32, prior_cost: f64) -> Stratum {
        Stratum { object, material, prior_cost, apart: false }
    }

    #[test]
    fn classes_are_the_different_expected_costs() {
        let strata = [stratum(0, 0, 1.0), stratum(1, 0, 3.0), stratum(2, 1, 1.0), stratum(3, 1, 0.1)];
        let (list, of) = classes(&strata);
        assert_eq!(of, [1, 2, 1, 0]);
        assert_eq!(list.iter().map(|class| class.prior_cost).collect::<Vec<_>>(), [0.1, 1.0, 3.0]);
    }

    #[test]
    fn every_object_has_its_share_to_within_one_pixel_and_every_pixel_its_chance() {
        // Three objects of one class, in 640 pixels of which 64 are sampled.
        let image = Image { width: 32, height: 20 };
        let ids: Vec<u32> = (0..640).map(|pixel| if pixel < 335 { 0 } else { 1 + pixel % 2 }).collect();
        let strata = [stratum(0, 5, 1.0), stratum(1, 2, 1.0), stratum(2, 2, 1.0)];
        let mut counts = vec![0; 3];
        ids.iter().for_each(|&id| counts[id as usize] += 1);
        let mut times = vec![0u32; 640];
        for seed in 0..2000 {
            let found = picks(&strata, &counts, &ids, image, 64, [seed, 1]);
            assert_eq!(found.len(), 64);
            let mut own = [0.0f64; 3];
            for pick in &found {
                times[pick.pixel as usize] += 1;
                own[ids[pick.pixel as usize] as usize] += 1.0;
            }
            for (n, &size) in own.iter().zip(&counts) {
                assert!((n - f64::from(size) / 10.0).abs() < 1.0 + 1e-9, "{own:?}");
            }
        }
        assert!(times.iter().all(|&n| (130..=270).contains(&n)), "200 each, give or take five deviations");
    }
}
