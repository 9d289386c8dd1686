//! Results of previews and profiles, in the terms of the wire.

use crate::answers::ShotInfo;
use crate::profile::noise::noise_strata;
use crate::profile::strata::{forecast_strata, record_prior_cost};
use crate::profile::{CountedFrames, ProfiledFrame};
use crate::shared_cache::cache_sample;
use forelight_forecast::Observation;
use forelight_forecast::accuracy::PixelNoise;
use forelight_protocol::{
    CacheMode, FrameStrata, NoiseCell, NoiseSample, PreviewResult, ProfileArtifacts, ProfileResult,
    ProfileSample, RenderSettings, Stratum, UncoveredGathers,
};
use forelight_tracer::{Pixel, Settings};
use std::collections::BTreeSet;

/// Counts of frames as protocol data, with the strata that any of them shows.
pub fn preview_result(
    info: &ShotInfo,
    frames: &[u32],
    settings: &RenderSettings,
    counted: &CountedFrames,
) -> PreviewResult {
    let background = info.strata.len();
    let seen = |stratum: usize| counted.counts.iter().any(|counts| counts[stratum] > 0);
    let shown = Shown::new(info, settings, (0..background).filter(|&stratum| seen(stratum)));
    let frames = frames.iter().enumerate().map(|(at, &frame)| FrameStrata {
        frame,
        pixels: shown.strata.iter().map(|&stratum| counted.counts[at][stratum]).collect(),
        background: counted.counts[at][background],
        cache_records: counted.cache_records[at].clone(),
        cache_plan: counted.cache_plans[at],
        lights: counted.lights[at],
        shining: counted.shining[at],
        triangles: counted.triangles[at],
        preview_png: None,
    });
    PreviewResult {
        frames: frames.collect(),
        background_prior_cost: shown.background_prior_cost,
        record_prior_cost: record_prior_cost(settings),
        strata: shown.list,
        backend: counted.backend,
        spent: counted.spent,
        described: None,
    }
}

/// A profiled frame as protocol data, with the strata that were sampled.
pub fn profile_result(
    info: &ShotInfo,
    settings: &RenderSettings,
    profiled: &ProfiledFrame,
    artifacts: ProfileArtifacts,
) -> ProfileResult {
    let sampled = profiled.shown.iter().map(|&stratum| stratum as usize);
    let shown = Shown::new(info, settings, sampled.filter(|&stratum| stratum < info.strata.len()));
    let sample = |((&(index, pixel), observation), &stratum): ((&(u32, Pixel), &Observation), &u32)| {
        let cost = observation.cost;
        ProfileSample {
            pixel: index,
            stratum: shown.place(stratum as usize),
            work: cost.work,
            extra_work: pixel.extra_work,
            work_by_ray: pixel.work_by_ray,
            cpu_nanos: cost.cpu_nanos,
            rays: cost.rays,
        }
    };
    // Pixels after the observed ones were traced for their time only.
    let samples =
        profiled.traced.iter().zip(&profiled.observations).zip(&profiled.shown).map(sample).collect();
    ProfileResult {
        frame: profiled.frame,
        samples,
        uncovered: uncovered_gathers(settings),
        shared_samples: Vec::new(),
        cache_samples: profiled.records.iter().map(cache_sample).collect(),
        shared_cache_samples: Vec::new(),
        noise: noise_cells(info, settings, profiled),
        samples_for_error: None,
        effects: profiled.effects.clone(),
        left_out: profiled.left_out.clone(),
        renderer: Some(info.renderer.clone()),
        work_by_class: profiled.work_by_class,
        fixed: profiled.fixed,
        once: Some(profiled.once),
        file_bytes: None,
        ladders: None,
        spent: profiled.spent(),
        strata: shown.list,
        artifacts,
    }
}

/// Noise of the profiled pixels, as protocol data.
fn noise_cells(info: &ShotInfo, settings: &RenderSettings, profiled: &ProfiledFrame) -> Vec<NoiseCell> {
    // With an irradiance cache, the error of interpolation would be missing.
    let known = profiled.noise.as_ref().filter(|noise| noise.is_known() && settings.cache == CacheMode::Off);
    let Some(noise) = known else { return Vec::new() };
    let strata = noise_strata(&info.strata, settings);
    // The strata are the frame's own, so they match.
    let cells = noise.cells(&strata, &noise.counts).unwrap_or_default();
    // Seven digits are enough for an estimate from few pixels.
    let sample = |sample: PixelNoise| NoiseSample {
        brightness: sample.brightness as f32,
        drops: sample.drops.into_iter().map(|drop| drop as f32).collect(),
    };
    cells
        .into_iter()
        .map(|cell| NoiseCell {
            // At most the pixels of an image.
            pixels: u32::try_from(cell.pixels).unwrap_or(u32::MAX),
            samples: cell.samples.into_iter().map(sample).collect(),
        })
        .collect()
}

/// The strata in a result, in the order of the shot. Estimates add up in this order, for the same bits.
struct Shown {
    strata: Vec<usize>,
    list: Vec<Stratum>,
    background_prior_cost: f64,
}

impl Shown {
    fn new(info: &ShotInfo, settings: &RenderSettings, strata: impl Iterator<Item = usize>) -> Self {
        let strata: Vec<usize> = strata.collect::<BTreeSet<usize>>().into_iter().collect();
        let all = forecast_strata(&info.strata, settings);
        let wire = |&stratum: &usize| Stratum {
            name: info.strata[stratum].name.clone(),
            object: all[stratum].object,
            material: all[stratum].material,
            prior_cost: all[stratum].prior_cost,
        };
        let list = strata.iter().map(wire).collect();
        Self { strata, list, background_prior_cost: all[info.strata.len()].prior_cost }
    }

    /// Index of a stratum in the list. The background, or any other stratum, comes after the last.
    fn place(&self, stratum: usize) -> u32 {
        self.strata.binary_search(&stratum).unwrap_or(self.strata.len()) as u32
    }
}

/// How a frame gathers at uncovered points. `None` without an irradiance cache.
pub(crate) fn uncovered_gathers(settings: &RenderSettings) -> Option<UncoveredGathers> {
    let forelight_tracer::UncoveredGathers { first, least } = Settings::from(settings).cache?.uncovered();
    Some(UncoveredGathers { first, least })
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::CacheMode;
    use forelight_protocol::RenderSettingsRequest;

    #[test]
    fn a_profile_says_how_the_tracer_gathers_where_no_record_is() {
        let request = RenderSettingsRequest {
            cache: Some(CacheMode::On),
            cache_rays: Some(768),
            cache_accuracy: Some(150),
            ..RenderSettingsRequest::default()
        };
        let settings = request.complete((64, 36));
        let said = uncovered_gathers(&settings).unwrap();
        let done = Settings::from(&settings).cache.unwrap().uncovered();
        let above =
            |samples: u32| (1..=samples).map(|n| f64::from(done.of_sample(n) - done.least)).sum::<f64>();
        for (from, to) in [(1, 2), (4, 16), (16, 4), (64, 1000)] {
            assert_eq!(said.growth(from, to), above(to) / above(from));
        }
        assert_eq!(uncovered_gathers(&RenderSettings { cache: CacheMode::Off, ..settings }), None);
    }
}
