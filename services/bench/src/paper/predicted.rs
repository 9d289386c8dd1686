//! Predicts the cost of each pixel by a strategy.

use anyhow::Result;
use forelight_forecast::{
    Calibration, Costs, Design, Observation, Pick, Strategy, Stratum, estimate, nearest,
};

/// Predicted cost of every pixel, in row order. Strategies that use the preview predict the mean of what the
/// pixel shows. Blind strategies predict the cost of the nearest profiled pixel.
///
/// `strata`, `ids` (stratum of every pixel) and `width` (pixels) are those of `design`. `observations` has
/// one entry for each of `picks`.
///
/// # Errors
/// If nothing was profiled, or if observations and picks do not match.
pub fn map(
    strategy: Strategy,
    design: &Design,
    (strata, ids): (&[Stratum], &[u32]),
    width: u32,
    picks: &[Pick],
    observations: &[Observation],
) -> Result<Vec<Costs<f64>>> {
    if strategy.is_blind() {
        let pixels: Vec<u32> = picks.iter().map(|pick| pick.pixel).collect();
        let cost = |index: u32| Costs::from(observations[index as usize].cost);
        return Ok(nearest(width, ids.len(), &pixels).into_iter().map(cost).collect());
    }
    let means = if strategy == Strategy::Systematic {
        // The strategy expands by class, but the map shows strata.
        let mut counts = vec![0; strata.len()];
        ids.iter().for_each(|&id| counts[id as usize] += 1);
        let shown: Vec<Observation> = picks
            .iter()
            .zip(observations)
            .map(|(pick, observed)| Observation { stratum: ids[pick.pixel as usize], ..*observed })
            .collect();
        estimate(strata, &counts, &shown, Calibration::NONE)?.strata
    } else {
        design.estimate(observations, Calibration::NONE)?.strata
    };
    Ok(ids.iter().map(|&id| means[id as usize].mean).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_forecast::Cost;

    const SIDE: u32 = 32;

    #[test]
    fn a_map_adds_up_to_the_estimate_where_objects_are_known() {
        // Sixteen square objects of four materials, with costs that differ between and within them.
        let strata: Vec<Stratum> = (0..16)
            .map(|object| Stratum { object, material: object % 4, prior_cost: 1.0, apart: false })
            .collect();
        let object = |pixel: u32| pixel / SIDE / 8 * 4 + pixel % SIDE / 8;
        let ids: Vec<u32> = (0..SIDE * SIDE).map(object).collect();
        let cost = |pixel: u32| {
            let work = 100 + 50 * u64::from(object(pixel)) + u64::from(pixel * 7919 % 97);
            Cost { work, ..Cost::default() }
        };
        for strategy in Strategy::ALL {
            let design = strategy.design(&strata, &ids, SIDE, 100, 3, 0).unwrap();
            let (picks, observations) = design.profile(cost).unwrap();
            let map = map(strategy, &design, (&strata, &ids), SIDE, &picks, &observations).unwrap();
            assert_eq!(map.len(), 1024);
            let total: f64 = map.iter().map(|costs| costs.work).sum();
            let estimate = design.estimate(&observations, Calibration::NONE).unwrap().total.work.mean;
            // The systematic strategy expands by class, while its map shows objects.
            let sums = !strategy.is_blind() && strategy != Strategy::Systematic;
            if sums || strategy == Strategy::RandomArea {
                assert!((total / estimate - 1.0).abs() < 1e-9, "{strategy:?}");
            }
            for (pick, observation) in picks.iter().zip(&observations).filter(|_| strategy.is_blind()) {
                assert_eq!(map[pick.pixel as usize].work, observation.cost.work as f64);
            }
        }
    }
}
