//! How measured pixels stand for all pixels of a frame.

use serde::{Deserialize, Serialize};

use crate::cost::{COLUMNS, Observation, Row};
use crate::error::ForecastError;

/// How measured pixels stand for all pixels. It concerns pixels alone: what stands apart is always expanded stratum by stratum.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Expansion {
    /// By groups of strata; strata that are too small are joined, and what has too few samples borrows: see [`crate::estimate`].
    /// The order of the observations does not matter.
    #[default]
    Groups,
    /// By strata, as the paper has it (its section 3): Σ N_h ȳ_h. A stratum with one sample costs what this costs; one without takes
    /// the mean of all samples, of which the paper says nothing.
    EachStratum,
    /// By all pixels: N ȳ, with the variance N² (1 − n/N) s² / n of a simple random sample (Cochran 1977, section 2.6).
    Flat,
    /// By strata: Σ N_h ȳ_h. Successive observations of a stratum are neighbours in some order along which it was sampled
    /// systematically, and its variance is that of a sample with a stratum for every two of them, N_h² (1 − n_h/N_h) / n_h ·
    /// Σ (y_(i+1) − y_i)² / (2 (n_h − 1)) (successive differences: Cochran 1977, section 8.11).
    Neighbours,
    /// By the pixels that each observation stands for, in the order of the observations: Σ a_i y_i. With the variance of
    /// [`Expansion::Flat`] in place of its own, which is not known.
    Areas(Vec<u32>),
}

impl Expansion {
    /// Whether all pixels are one group to it.
    pub(crate) fn is_of_all(&self) -> bool {
        matches!(self, Expansion::Flat | Expansion::Areas(_))
    }

    /// Total by the areas, if there are any. `observations` are those of pixels.
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

    /// Variance of one observation of each stratum by differences of successive ones, if that is how they are seen; none for a stratum
    /// with less than two.
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
