//! How measured pixels are expanded to all pixels of a frame.

use serde::{Deserialize, Serialize};

use crate::cost::{COLUMNS, Observation, Row};
use crate::error::ForecastError;

/// The estimator that expands measured pixels to a frame. Cache records are always expanded by stratum.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Expansion {
    /// By groups of strata, see [`crate::estimate()`]. Strata that are too small are joined, and groups with
    /// too few samples borrow. The order of the observations does not matter.
    #[default]
    Groups,
    /// By strata, as in the paper (Gillibrand et al. 2006, section 3): Σ N_h ȳ_h. A stratum without samples
    /// takes the mean of all samples; the paper does not say.
    EachStratum,
    /// All pixels: N ȳ, with the simple-random variance N² (1 − n/N) s² / n (Cochran 1977, section 2.6).
    Flat,
    /// By strata: Σ N_h ȳ_h, for a systematic sample along an order in which successive observations are
    /// neighbours. Variance by successive differences: N_h² (1 − n_h/N_h) / n_h · Σ (y_(i+1) − y_i)² / (2
    /// (n_h − 1)) (Cochran 1977, section 8.11).
    Neighbours,
    /// By the number of pixels a_i that each observation stands for, in the order of the observations: Σ a_i
    /// y_i. The variance of this estimator is not known; that of [`Expansion::Flat`] takes its place.
    Areas(Vec<u32>),
}

impl Expansion {
    /// Whether it treats all pixels as one group.
    pub(crate) fn is_one_group(&self) -> bool {
        matches!(self, Expansion::Flat | Expansion::Areas(_))
    }

    /// The total by areas, for [`Expansion::Areas`]. `observations` are those of pixels.
    pub(crate) fn total_by_areas<'a>(
        &self,
        pixels: u64,
        observations: impl Iterator<Item = &'a Observation>,
    ) -> Result<Option<Row>, ForecastError> {
        let Expansion::Areas(areas) = self else { return Ok(None) };
        let mut total = [0u128; COLUMNS];
        let mut count = 0;
        for observation in observations {
            let area = areas.get(count).copied().unwrap_or(0);
            count += 1;
            for (sum, value) in total.iter_mut().zip(observation.cost.columns()) {
                *sum += u128::from(area) * value;
            }
        }
        let covered = areas.iter().map(|&area| u64::from(area)).sum::<u64>();
        if count != areas.len() || covered != pixels {
            return Err(ForecastError::Areas { areas: areas.len(), covered, observations: count, pixels });
        }
        Ok(Some(total.map(|sum| sum as f64)))
    }

    /// Variance of one observation of each stratum by successive differences, for [`Expansion::Neighbours`].
    /// `None` for a stratum with fewer than two observations. Empty for other expansions.
    pub(crate) fn successive_variances(
        &self,
        strata: usize,
        observations: &[Observation],
    ) -> Vec<Option<Row>> {
        if *self != Expansion::Neighbours {
            return Vec::new();
        }
        let mut squares = vec![([0.0; COLUMNS], 0u64); strata];
        let mut before: Vec<Option<Row>> = vec![None; strata];
        for observation in observations {
            let stratum = observation.stratum as usize;
            let row = observation.cost.columns().map(|value| value as f64);
            if let Some(before) = before[stratum].replace(row) {
                let (sums, pairs) = &mut squares[stratum];
                *pairs += 1;
                for (sum, (one, other)) in sums.iter_mut().zip(row.iter().zip(&before)) {
                    *sum += (one - other) * (one - other);
                }
            }
        }
        let variance =
            |(sums, pairs): (Row, u64)| (pairs > 0).then(|| sums.map(|sum| sum / (2 * pairs) as f64));
        squares.into_iter().map(variance).collect()
    }
}
