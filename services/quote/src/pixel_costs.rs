//! Forecasts the cost of single pixels.

use std::collections::BTreeMap;

use forelight_forecast::{Cost, Observation, PixelCosts};

use crate::error::QuoteError;
use crate::measured::Measured;

/// Work of a pixel by what it shows. Records of an irradiance cache are not included.
#[derive(Clone, PartialEq, Debug)]
pub struct PixelWork {
    by_stratum: BTreeMap<(u32, u32), f64>,
    background: f64,
}

impl PixelWork {
    /// Work of a pixel that shows this material of this object.
    pub fn of(&self, object: u32, material: u32) -> f64 {
        self.by_stratum.get(&(object, material)).copied().unwrap_or(self.background)
    }

    /// Work of a background pixel.
    pub fn of_background(&self) -> f64 {
        self.background
    }
}

impl Measured<'_> {
    /// Work of a pixel of the frame: the mean, or the quantile at `probability`. Needs the strategy Snapshot.
    /// `None` if the preview lacks the frame, or if too few pixels were profiled for that quantile.
    pub fn pixel_work(&self, frame: u32, probability: Option<f64>) -> Result<Option<PixelWork>, QuoteError> {
        let place = |number: u32| self.preview.frames.iter().position(|frame| frame.frame == number);
        let Some(at) = place(frame) else { return Ok(None) };
        let estimate = self.estimate()?;
        let populations = &estimate.populations;
        let strata = &populations.strata[..populations.pixel_strata];
        let means = |at: usize| -> Vec<f64> {
            let known = estimate.shot.frames[at].strata.iter().take(strata.len());
            known.map(|stratum| stratum.mean.work).collect()
        };
        let costs = match probability {
            None => Some(means(at)),
            Some(probability) => {
                // Frames that are close in time vary alike.
                let profiles = self.profiles.iter().zip(&estimate.sampled);
                let nearest = profiles.min_by_key(|(profile, _)| profile.result.frame.abs_diff(frame));
                let Some((nearest, sampled)) = nearest else { return Ok(None) };
                let Some(there) = place(nearest.result.frame) else { return Ok(None) };
                let seen: Vec<Observation> = nearest
                    .result
                    .samples
                    .iter()
                    .zip(sampled)
                    .map(|(sample, &stratum)| {
                        let cost = Cost { work: sample.work, cpu_nanos: sample.cpu_nanos, rays: sample.rays };
                        Observation { stratum, cost }
                    })
                    .collect();
                let counts = |at: usize| &populations.frames[at].counts[..strata.len()];
                let known = PixelCosts::new(strata, counts(there), &seen).at(probability);
                let cost = |(stratum, (here, there)): (usize, (f64, f64))| match counts(at)[stratum] {
                    // No pixel shows this stratum, so it needs no cost.
                    0 => Some(here),
                    _ => known.of(stratum, there, here),
                };
                means(at).into_iter().zip(means(there)).enumerate().map(cost).collect()
            }
        };
        let Some(costs): Option<Vec<f64>> = costs else { return Ok(None) };
        let Some((&background, costs)) = costs.split_last() else { return Ok(None) };
        let by_stratum =
            strata.iter().zip(costs).map(|(stratum, &cost)| ((stratum.object, stratum.material), cost));
        Ok(Some(PixelWork { by_stratum: by_stratum.collect(), background }))
    }
}
