//! Why frames are dear: a quote taken apart.

use crate::ambient::uncovered_gathers;
use crate::quote::Quote;
use crate::renderer::StratumInfo;
use forelight_forecast::StratumSum;
use forelight_protocol::{Amounts, Explanation, ProfiledWork, RenderSettings, ShownWork};

impl Quote {
    /// What the quote's work goes into. `strata` are the shot's. Objects are told apart only if the pixels were chosen by them.
    pub fn explained(&self, strata: &[StratumInfo], settings: &RenderSettings) -> Explanation {
        let frames = self.forecast.frames.iter().map(|frame| &frame.strata[..]);
        let records = self.document.total.cache_records.len();
        let sums = StratumSum::over(frames);
        let (pixels, gathered) = sums.split_at(sums.len() - records.min(sums.len()));
        let shown = |(place, sum): (usize, &StratumSum)| ShownWork {
            shows: strata.get(place).map(|stratum| stratum.name.clone()),
            pixels: sum.pixels,
            samples: sum.samples,
            work: sum.work,
            profiled: ProfiledWork::default(),
        };
        let told_apart = pixels.len() == strata.len() + 1;
        let mut pixels: Vec<ShownWork> = pixels.iter().enumerate().map(shown).collect();
        for (observation, (_, pixel)) in
            self.profiled.iter().flat_map(|frame| frame.observations.iter().zip(&frame.traced))
        {
            if let Some(shown) = pixels.get_mut(observation.stratum as usize) {
                shown.profiled.note_rays(&pixel.work_by_ray);
                shown.profiled.note_extra(pixel.work, pixel.extra_work);
            }
        }
        let amounts = Amounts {
            frame: None,
            work: self.forecast.total.work.mean,
            told_apart,
            pixels,
            records_work: gathered.iter().map(|sum| sum.work).collect(),
            fixed: self.document.fixed,
            shares_cache: false,
            rays: self.forecast.total.rays.map(|rays| rays.mean),
            uncovered: uncovered_gathers(settings),
        };
        Explanation::new(amounts, settings)
    }
}
