//! A pilot: profiled pixels of one kind of setting.

use crate::accuracy::denoising::Noisy;
use crate::accuracy::observer::{AccuracyObserver, is_cancelled};
use crate::answers::Previewed;
use crate::costs::cost_of_record;
use crate::error::{RenderError, ShotError};
use crate::frame::OwnFrame;
use crate::profile::noise::{FrameNoise, Zones, noise_strata};
use crate::profile::strata::{forecast_strata, record_prior_cost};
use crate::profile::{self, Observer, profile_ready};
use crate::quote_options::QuoteOptions;
use crate::render::denoised::normal_error;
use crate::results::uncovered_gathers;
use crate::shot::OwnShot;
use forelight_forecast::accuracy::{ImageNoise, MeanSquare};
use forelight_forecast::{
    Calibration, Cost, Expansion, ForecastError, FramePopulation, Observation, ProfiledFrame, RecordStrata,
    Stratum, forecast_shot,
};
use forelight_preview::Preview;
use forelight_protocol::{FixedCosts, ImageError, Quantiles, RenderSettings, Spent};
use forelight_quote::{image_error, quantiles};
use forelight_tracer::{Pixel, RecordCost};
use std::collections::BTreeMap;

/// Counts of a frame at one resolution.
#[derive(Debug, Clone)]
pub struct View {
    /// Pixels by stratum of cost, the background last.
    counts: Vec<u32>,
    pub noise_counts: Vec<u32>,
    cache_records: Vec<u32>,
    fixed: FixedCosts,
}

impl View {
    pub fn of(ready: &OwnFrame<'_>) -> Result<(Self, Spent), RenderError> {
        let seen = ready.preview()?;
        let view = Self::new(ready, &seen.preview, &Zones::new(ready, &seen.preview));
        let spent = seen.spent.plus(ready.spent_on_setup()).plus(view.fixed.plan);
        Ok((view, spent))
    }

    fn new(ready: &OwnFrame<'_>, preview: &Preview, zones: &Zones) -> Self {
        let shown = preview.counts();
        let mut counts = shown.per_stratum;
        counts.push(shown.background);
        Self {
            counts,
            noise_counts: zones.counts.clone(),
            cache_records: ready.cache_records(),
            fixed: ready.fixed(),
        }
    }
}

/// Profiled pixels of one kind of setting.
pub struct Pilot {
    pub settings: RenderSettings,
    pub view: View,
    strata: Vec<Stratum>,
    pub noise_strata: Vec<Stratum>,
    observations: Vec<Observation>,
    /// For each observation, the part of its work that does not grow with camera samples.
    extra_work: Vec<u64>,
    records: Vec<RecordCost>,
    /// Noise of the pixels. With an irradiance cache it is empty until
    /// [`super::interpolation::Truth::interpolated`] fills it in. Without the interpolation error.
    pub noise: FrameNoise,
    /// Interpolation error at some of the pixels. `None` without an irradiance cache.
    pub interpolation: Option<FrameNoise>,
    /// Which pixel is in which of `noise_strata`.
    pub zones: Zones,
    /// For each pixel of `noise`, the part of its work that grows with camera samples.
    pub pixel_work: Vec<u64>,
    pub spent: Spent,
    /// The part of `spent` that a render of the frame would not need: pixels and preview.
    pub overhead: Spent,
}

impl Pilot {
    pub fn new(
        shot: &OwnShot,
        ready: &OwnFrame<'_>,
        settings: RenderSettings,
        options: &QuoteOptions,
        observer: &dyn AccuracyObserver,
    ) -> Result<Self, ShotError> {
        let strata = &shot.info().strata;
        let (profiled, seen) = profile_ready(ready, strata, &settings, options, &Watching(observer))?;
        Ok(Self::of(shot, ready, settings, &profiled, &seen))
    }

    /// The pilot that a profile makes.
    pub fn of(
        shot: &OwnShot,
        ready: &OwnFrame<'_>,
        settings: RenderSettings,
        profiled: &profile::ProfiledFrame,
        seen: &Previewed,
    ) -> Self {
        let shot = &shot.info().strata;
        let zones = Zones::new(ready, &seen.preview);
        let view = View::new(ready, &seen.preview, &zones);
        let by_samples = |pixel: &Pixel| pixel.work.saturating_sub(pixel.extra_work);
        let traced: BTreeMap<u32, u64> =
            profiled.traced.iter().map(|(index, pixel)| (*index, by_samples(pixel))).collect();
        let overhead = profiled.pixels.plus(profiled.scan).plus(profiled.preview);
        let noise = profiled.noise.clone().unwrap_or_else(|| FrameNoise {
            counts: view.noise_counts.clone(),
            pixels: Vec::new(),
            samples: Vec::new(),
            scattered: 0,
            scanned: Vec::new(),
        });
        let work = |pixel: &u32| traced.get(pixel).copied().unwrap_or_default();
        Self {
            pixel_work: noise.pixels.iter().map(work).collect(),
            overhead,
            zones,
            noise,
            interpolation: None,
            strata: forecast_strata(shot, &settings),
            noise_strata: noise_strata(shot, &settings),
            extra_work: profiled.traced.iter().map(|(_, pixel)| pixel.extra_work).collect(),
            observations: profiled.observations.clone(),
            records: profiled.records.clone(),
            spent: profiled.spent(),
            settings,
            view,
        }
    }

    pub fn profiled(&self) -> u64 {
        self.observations.len() as u64
    }

    /// Error of a frame with `spp` camera samples per pixel and the counts of `view`.
    pub fn error(&self, view: &View, spp: u32) -> Result<ImageError, ShotError> {
        let noise = self.image(&self.noise, view)?.noise_at(spp);
        let square = match &self.interpolation {
            Some(interpolation) => noise.plus(self.image(interpolation, view)?.bias_square()),
            None => noise,
        };
        Ok(image_error(square.error(Calibration::NONE)))
    }

    /// The same in two parts.
    pub fn noisy(&self, view: &View, spp: u32) -> Result<Noisy, ShotError> {
        let noise = image_error(self.image(&self.noise, view)?.noise_at(spp).error(Calibration::NONE));
        let of_cache = match &self.interpolation {
            Some(interpolation) => {
                // A mean of products of both signs, which may be hardly above 0: not log-normal.
                let MeanSquare { value, variance, .. } = self.image(interpolation, view)?.bias_square();
                normal_error(value, variance.sqrt())
            }
            None => ImageError::default(),
        };
        Ok(Noisy { noise, of_cache })
    }

    /// Mean of the image.
    pub fn mean(&self) -> Result<f64, ShotError> {
        Ok(self.image(&self.noise, &self.view)?.mean())
    }

    fn image(&self, noise: &FrameNoise, view: &View) -> Result<ImageNoise, ForecastError> {
        ImageNoise::new(noise.cells(&self.noise_strata, &view.noise_counts)?)
    }

    /// Work and CPU seconds of a frame with `spp` camera samples per pixel and the counts of `view`.
    pub fn cost(&self, view: &View, spp: u32) -> Result<(Quantiles, Quantiles), ShotError> {
        self.cost_with(view, spp, &view.cache_records, view.fixed)
    }

    /// Median CPU seconds of tracing the pixels of such a frame.
    pub fn traced_seconds(&self, view: &View, spp: u32) -> Result<f64, ShotError> {
        let (_, cpu_seconds) = self.cost_with(view, spp, &[], FixedCosts::default())?;
        Ok(cpu_seconds.p50)
    }

    /// The cost with so many records, and these fixed costs.
    fn cost_with(
        &self,
        view: &View,
        spp: u32,
        records: &[u32],
        fixed: FixedCosts,
    ) -> Result<(Quantiles, Quantiles), ShotError> {
        let had = self.settings.spp;
        let factor = f64::from(spp) / f64::from(had);
        let growth = uncovered_gathers(&self.settings).map_or(1.0, |gathers| gathers.growth(had, spp));
        let mut strata = self.strata.clone();
        let of_pixels = self.observations.iter().zip(&self.extra_work).map(|(seen, &extra)| Observation {
            stratum: seen.stratum,
            cost: seen.cost.with_samples(factor, extra, growth),
        });
        let mut observations = of_view(&view.counts, of_pixels.collect());
        // A smaller image may have fewer pixels of a stratum than were profiled: forecast copies of it.
        let copies = copies(&view.counts, &observations);
        let of_copies =
            |counts: &[u32]| counts.iter().map(|count| count.saturating_mul(copies)).collect::<Vec<u32>>();
        let records = of_copies(records);
        let counts = of_copies(&view.counts);
        let mut frame = [FramePopulation { number: 0, counts, lights: 0, shining: 0, triangles: 0 }];
        let prior_cost = record_prior_cost(&self.settings).unwrap_or(1.0);
        let apart = RecordStrata::add(&mut strata, &mut frame, &[&records], prior_cost);
        let mut room = vec![0; records.len()];
        for record in &self.records {
            if let Some(room) = room.get_mut(record.level as usize)
                && *room < records[record.level as usize]
            {
                *room += 1;
                observations.push(apart.observation(record.level, cost_of_record(record)));
            }
        }
        let Spent { work, cpu_nanos } = fixed.total();
        let times = u64::from(copies);
        let fixed = Cost {
            work: work.saturating_mul(times),
            cpu_nanos: cpu_nanos.saturating_mul(times),
            rays: fixed.plan_rays.map(|rays| rays * times),
        };
        let expansion = &Expansion::Groups;
        let profiled = [ProfiledFrame {
            frame: 0,
            observations: &observations,
            fixed,
            build: Cost::default(),
            expansion,
        }];
        let forecast = forecast_shot(&strata, &frame, &profiled, Calibration::NONE)?;
        let total = &forecast.total;
        let one = 1.0 / f64::from(copies);
        Ok((quantiles(&total.work, one), quantiles(&total.cpu_nanos, 1e-9 * one)))
    }
}

/// The observations of strata that a view shows. If there are none, the average cost of all observations.
fn of_view(counts: &[u32], observations: Vec<Observation>) -> Vec<Observation> {
    let shown = |seen: &&Observation| counts[seen.stratum as usize] > 0;
    let own: Vec<Observation> = observations.iter().filter(shown).copied().collect();
    match (own.is_empty(), (0..).zip(counts).find(|(_, count)| **count > 0)) {
        (true, Some((stratum, _))) => {
            let costs: Vec<Cost> = observations.iter().map(|seen| seen.cost).collect();
            vec![Observation { stratum, cost: Cost::mean(&costs) }]
        }
        _ => own,
    }
}

/// How many copies of a view are needed to have as many pixels of each stratum as were observed.
fn copies(counts: &[u32], observations: &[Observation]) -> u32 {
    let mut seen = vec![0u32; counts.len()];
    observations.iter().for_each(|observation| seen[observation.stratum as usize] += 1);
    let times = |(count, seen): (&u32, u32)| if *count > 0 { seen.div_ceil(*count) } else { 1 };
    counts.iter().zip(seen).map(times).max().unwrap_or(1).max(1)
}

struct Watching<'a>(&'a dyn AccuracyObserver);

impl Observer for Watching<'_> {
    fn previewed(&self, _: usize, _: usize) {}
    fn profiled(&self, _: usize, _: usize) {}
    fn is_cancelled(&self) -> bool {
        is_cancelled(self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{Nobody, kitchen};
    use crate::{Given, render_frame};
    use forelight_protocol::{CacheMode, RenderSettingsRequest};

    #[test]
    fn a_smaller_image_costs_what_its_own_pixels_do_however_many_of_a_larger_one_were_profiled() {
        let (shot, nobody) = (kitchen(), Nobody::default());
        let request = RenderSettingsRequest { spp: Some(4), ..RenderSettingsRequest::default() };
        let settings = request.complete((32, 18));
        let ready = shot.frame(0, &settings).unwrap();
        let options = QuoteOptions { samples: 256, seed: 2, ..QuoteOptions::default() };
        let pilot = Pilot::new(&shot, &ready, settings.clone(), &options, &nobody).unwrap();
        for (width, height) in [(16, 9), (8, 5)] {
            let settings = RenderSettings { width, height, ..settings.clone() };
            let (view, _) = View::of(&shot.frame(0, &settings).unwrap()).unwrap();
            let rendered = render_frame(&shot, 0, &settings, Given::default(), &|_| (), nobody.cancel())
                .unwrap()
                .unwrap();
            let (work, _) = pilot.cost(&view, settings.spp).unwrap();
            let off = work.mean / rendered.stats.work as f64 - 1.0;
            println!("{width} x {height}: {off:+.3}");
            // Forty pixels differ from their neighbours, but a sixteenth of all must not cost half.
            assert!(off.abs() < 0.25, "{width} x {height}: {off}");
        }
    }

    #[test]
    fn views_of_a_few_pixels_have_a_price_whatever_was_profiled() {
        let (shot, nobody) = (kitchen(), Nobody::default());
        let options = QuoteOptions { samples: 16, seed: 2, scans: true, ..QuoteOptions::default() };
        let sizes = [(1, 1), (2, 2), (3, 1), (5, 3)].map(|(width, height)| RenderSettings {
            width,
            height,
            ..RenderSettingsRequest { spp: Some(1), ..RenderSettingsRequest::default() }.complete((1, 1))
        });
        for own in &sizes {
            let ready = shot.frame(0, own).unwrap();
            let pilot = Pilot::new(&shot, &ready, own.clone(), &options, &nobody).unwrap();
            for other in &sizes {
                let (view, _) = View::of(&shot.frame(0, other).unwrap()).unwrap();
                let (work, seconds) = pilot.cost(&view, 4).unwrap();
                assert!(work.mean > 0.0 && work.p95.is_finite() && seconds.p95.is_finite(), "{work:?}");
            }
        }
    }

    #[test]
    fn what_was_profiled_speaks_for_views_in_which_there_is_less_of_it() {
        let seen = |stratum, work| Observation { stratum, cost: Cost { work, ..Cost::default() } };
        let all = vec![seen(0, 1), seen(1, 5), seen(0, 3), seen(0, 8), seen(2, 7)];
        let own = of_view(&[2, 9, 0], all.clone());
        assert_eq!(own, [seen(0, 1), seen(1, 5), seen(0, 3), seen(0, 8)]);
        assert_eq!(copies(&[2, 9, 0], &own), 2);
        assert_eq!(copies(&[3, 9, 0], &own), 1);
        assert_eq!(of_view(&[0, 0, 0, 4], [all, vec![seen(1, 1)]].concat()[..5].to_vec()), [seen(3, 5)]);
    }

    #[test]
    fn with_a_cache_too_other_numbers_of_samples_are_known_to_cost_what_they_do() {
        let (shot, nobody) = (kitchen(), Nobody::default());
        let request = RenderSettingsRequest {
            spp: Some(4),
            ambient_bounces: Some(1),
            cache: Some(CacheMode::On),
            cache_rays: Some(192),
            ..RenderSettingsRequest::default()
        };
        let settings = request.complete((32, 18));
        let ready = shot.frame(0, &settings).unwrap();
        // All pixels: what remains is the error of few records and of later samples.
        let options = QuoteOptions { samples: 32 * 18, seed: 2, ..QuoteOptions::default() };
        let pilot = Pilot::new(&shot, &ready, settings.clone(), &options, &nobody).unwrap();
        assert!(pilot.extra_work.iter().sum::<u64>() > 0);
        for spp in [1, 4, 16, 128] {
            let settings = RenderSettings { spp, ..settings.clone() };
            let given = Given::default();
            let rendered =
                render_frame(&shot, 0, &settings, given, &|_| (), nobody.cancel()).unwrap().unwrap();
            let (work, _) = pilot.cost(&pilot.view, spp).unwrap();
            let off = work.mean / rendered.stats.work as f64 - 1.0;
            println!("{spp} samples: {off:+.3}");
            // The plan saw the points of the first samples. Later ones are covered less often.
            assert!(off.abs() < 0.05, "{spp} samples: {off}");
        }
    }
}
