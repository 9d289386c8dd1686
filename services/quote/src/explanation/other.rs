//! Explains a quote of another renderer. Its work is CPU time in microseconds.

use forelight_forecast::Strategy;
use forelight_protocol::{
    Explanation, FixedPart, PreviewResult, RenderSettings, RenderSettingsRequest, ShotSettings, Varied,
    at_speed_one,
};
use std::collections::BTreeMap;

use super::amounts::{Amounts, ProfiledWork, ShownWork};
use super::explain;
use crate::error::QuoteError;
use crate::measured::Measured;
use crate::populations::Populations;
use crate::sampled::{MeasuredCosts, SampledProfile, forecast};

impl Measured<'_> {
    /// As [`Measured::explain`], of a renderer other than our own that profiles single pixels.
    ///
    /// # Errors
    /// The same.
    pub fn explain_shot(
        &self,
        settings: &ShotSettings,
        frame: Option<u32>,
    ) -> Result<Explanation, QuoteError> {
        self.explain(&common_settings(settings), frame)
    }
}

/// What all renderers have of the settings, as those of our own. The rest has defaults.
fn common_settings(settings: &ShotSettings) -> RenderSettings {
    let size = (settings.width.unwrap_or(1), settings.height.unwrap_or(1));
    RenderSettingsRequest { spp: settings.samples, ..RenderSettingsRequest::default() }.complete(size)
}

/// What the measured frames say of the costs that do not depend on samples: CPU time in nanoseconds of a node
/// of speed 1, in words. Empty if a frame says nothing.
fn fixed_parts(profiles: &[SampledProfile]) -> Vec<(String, f64)> {
    if profiles.iter().any(|profile| profile.result.fixed.is_empty()) {
        return Vec::new();
    }
    let mut sums: BTreeMap<&str, u64> = BTreeMap::new();
    for SampledProfile { result, node_speed } in profiles {
        for FixedPart { name, cpu_nanos } in &result.fixed {
            *sums.entry(in_words(name)).or_default() += at_speed_one(*cpu_nanos, *node_speed);
        }
    }
    sums.into_iter().map(|(name, nanos)| (name.to_owned(), nanos as f64)).collect()
}

/// What a renderer did, from its name in [`FixedPart`].
fn in_words(name: &str) -> &str {
    match name {
        "prepare" => "setting up",
        "scene" => "synchronising the scene",
        "tree" => "building the tree",
        "textures" => "loading textures",
        "kernels" => "loading kernels",
        "images" => "image buffers",
        "pixels" => "first samples, before caches are warm",
        "finish" => "denoising and compositing",
        "write" => "writing the image",
        own => own,
    }
}

/// Explains a shot that was measured as a few frames at few samples: all frames, or one.
///
/// What does not depend on the samples is apart. The rest of a frame is divided by what it shows, in
/// proportion to N_h u_h, with N_h pixels of the frame and u_h the time per pixel in all measured frames.
/// That needs a renderer that says where the time goes.
///
/// # Errors
/// Those of [`quote_sampled`](crate::quote_sampled), and if there is no such frame.
pub fn explain_sampled(
    preview: &PreviewResult,
    profiles: &[SampledProfile],
    settings: &ShotSettings,
    frame: Option<u32>,
) -> Result<Explanation, QuoteError> {
    let Populations { strata, frames, names, .. } = Populations::new(preview, [], Strategy::Snapshot, &[]);
    let (shot, measured) = forecast(&strata, &frames, profiles)?;
    let timed: Vec<&MeasuredCosts> = measured.iter().filter(|one| !one.times.is_empty()).collect();
    let over_timed = |value: &dyn Fn(&MeasuredCosts) -> f64| timed.iter().map(|one| value(one)).sum::<f64>();
    let pixels_of = |h: usize, frame: usize| f64::from(frames[frame].counts[h]);
    let seen: Vec<f64> = (0..strata.len()).map(|h| over_timed(&|one| pixels_of(h, one.frame))).collect();
    let times: Vec<f64> = (0..strata.len()).map(|h| over_timed(&|one| one.times[h])).collect();
    let mean = times.iter().sum::<f64>() / seen.iter().sum::<f64>().max(1.0);
    let unit = |h: usize| if seen[h] > 0.0 { times[h] / seen[h] } else { mean };
    let mut pixels: Vec<ShownWork> = (0..strata.len())
        .map(|h| ShownWork {
            shows: names.get(h).cloned(),
            pixels: 0,
            samples: seen[h] as u64,
            work: 0.0,
            profiled: ProfiledWork::default(),
        })
        .collect();
    let mut work = 0.0;
    for (t, forecast) in shot.frames.iter().enumerate() {
        if frame.is_some_and(|number| i64::from(number) != forecast.number) {
            continue;
        }
        let micros = forecast.cpu_nanos.mean * 1e-3;
        let of_pixels = (micros - forecast.fixed_nanos * 1e-3).max(0.0);
        work += micros;
        let weights: Vec<f64> = (0..strata.len()).map(|h| pixels_of(h, t) * unit(h)).collect();
        let all: f64 = weights.iter().sum();
        let count = frames[t].counts.iter().map(|&count| f64::from(count)).sum::<f64>().max(1.0);
        for (h, shown) in pixels.iter_mut().enumerate() {
            let share = if all > 0.0 { weights[h] / all } else { pixels_of(h, t) / count };
            shown.pixels += u64::from(frames[t].counts[h]);
            shown.work += of_pixels * share;
        }
    }
    if let Some(number) = frame.filter(|_| pixels.iter().all(|shown| shown.pixels == 0)) {
        return Err(QuoteError::NoFrame(number));
    }
    let amounts = Amounts {
        frame,
        work,
        pixels,
        told_apart: !timed.is_empty(),
        by_samples: profiles.iter().all(|profile| profile.result.varied == Varied::Samples),
        records_work: Vec::new(),
        fixed: None,
        fixed_parts: fixed_parts(profiles),
        shares_cache: false,
        rays: [0.0; 7],
        uncovered: None,
    };
    Ok(explain(amounts, &common_settings(settings)))
}
