//! Why frames are dear: a quote taken apart.

use crate::quote::Quote;
use crate::renderer::StratumInfo;
use forelight_forecast::StratumSum;
use forelight_protocol::{Amounts, Explanation, RenderSettings, ShownWork};

impl Quote {
    /// What the quote's work goes into. `strata` are the shot's. Objects are told apart only if the pixels were chosen by them.
    pub fn explained(&self, strata: &[StratumInfo], settings: &RenderSettings) -> Explanation {
        let frames = self.forecast.frames.iter().map(|frame| &frame.strata[..]);
        let records = self.document.total.cache_records.len();
        let sums = StratumSum::over(frames);
        let (pixels, gathered) = sums.split_at(sums.len() - records.min(sums.len()));
        let mut by_ray = vec![[0.0; 7]; sums.len()];
        let seen = self.profiled.iter().flat_map(|frame| frame.observations.iter().zip(&frame.traced));
        for (observation, (_, pixel)) in seen {
            if let Some(sum) = by_ray.get_mut(observation.stratum as usize) {
                sum.iter_mut().zip(pixel.work_by_ray).for_each(|(sum, work)| *sum += work as f64);
            }
        }
        let shown = |(place, sum): (usize, &StratumSum)| ShownWork {
            shows: strata.get(place).map(|stratum| stratum.name.clone()),
            pixels: sum.pixels,
            samples: sum.samples,
            work: sum.work,
            by_ray: by_ray[place],
        };
        let amounts = Amounts {
            frame: None,
            work: self.forecast.total.work.mean,
            told_apart: pixels.len() == strata.len() + 1,
            pixels: pixels.iter().enumerate().map(shown).collect(),
            records_work: gathered.iter().map(|sum| sum.work).sum(),
            fixed: self.document.fixed,
            rays: self.forecast.total.rays.map(|rays| rays.mean),
        };
        Explanation::new(amounts, settings)
    }
}
