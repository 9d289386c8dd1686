//! What accuracy costs in time, of a job: from its profile alone, nothing is traced for it.
//!
//! *Camera samples*: a profiled pixel costs in proportion to its samples, while records and fixed costs stay; so every rung is the
//! job's forecast with the profiled costs scaled. The error follows from the variance between the profiled pixels' camera samples
//! (`forelight_forecast::accuracy`), frame by frame.
//!
//! *Resolution*: strata have so many times the pixels, and pixels cost and err as they do.
//!
//! What the profile cannot know are the other integrator, other gathers; with an irradiance cache, its errors, for
//! profiled pixels are traced before it is filled, and other accuracies and resolutions, whose records no one has counted. Where the job asks
//! for these ladders, one of its frames was profiled with such settings too ([`one_frame`]); where not, they are named as missing.

mod one_frame;

use forelight_forecast::accuracy::{
    ErrorQuantiles, ImageNoise, MeanSquare, NoiseCell, PixelNoise, front_of_known,
};
use forelight_forecast::{Calibration, Cost};
use forelight_protocol::{
    AccuracyDoc, AccuracyRung, ImageError, Integrator, LadderKind, MissingLadder, PreviewResult,
    RenderSettings,
};
use forelight_store::MeasuredProfile;
use one_frame::{Job, OneFrame};

use super::estimate::calibrated;
use super::job_profile::JobProfile;
use super::sharing::SharedWay;
use super::{AdvanceError, compute};

/// The ladders of a job with these settings.
pub(crate) async fn accuracy(
    asked: RenderSettings,
    measured: JobProfile,
) -> Result<AccuracyDoc, AdvanceError> {
    compute(move || ladders(&asked, &measured.preview, &measured.profiles, measured.way().as_ref())).await
}

/// Of the ladders of [`LadderKind`], those that the profile knows something of; of frames that are given a `shared` irradiance cache, without what that
/// takes, or that make their own.
pub(super) fn ladders(
    asked: &RenderSettings,
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
    shared: Option<&SharedWay<'_>>,
) -> Result<AccuracyDoc, AdvanceError> {
    let whole = calibrated(preview, profiles, shared, None)?;
    let mut document = AccuracyDoc {
        frames: preview.frames.len() as u32,
        settings: asked.clone(),
        rungs: Vec::new(),
        missing: Vec::new(),
        profiled: whole.job.profiled,
        spent: whole.job.spent,
        calibrated: whole.job.calibrated,
    };
    let noise = images(profiles);
    let error_with = |spp| noise.as_ref().ok().and_then(|images| error(images, spp));
    let laid_out = profiles.iter().find_map(|profile| profile.result.ladders.as_deref());
    let frame = match laid_out {
        Some(laid_out) => {
            document.profiled.pixels = document.profiled.pixels.saturating_add(laid_out.profiled.pixels);
            // The frame made its own cache.
            let total = match shared {
                Some(_) => calibrated(preview, profiles, None, None)?.job.total,
                None => whole.job.total,
            };
            let error = error_with(asked.spp);
            OneFrame::new(laid_out, Job { work: total.work, cpu_seconds: total.cpu_seconds, error })
        }
        None => None,
    };
    let mut miss = |ladder, reason| document.missing.push(MissingLadder { ladder, reason });
    for kind in LadderKind::ALL {
        let rungs = match kind.rungs(asked) {
            Ok(rungs) => rungs,
            Err(reason) => {
                miss(kind, reason);
                continue;
            }
        };
        if !kind.is_own(asked) {
            let reason = unknown(kind, asked);
            match (never(kind, shared.is_some()), laid_out, &frame) {
                (Some(reason), ..) => miss(kind, format!("{reason}; `forelight accuracy` finds out")),
                (None, Some(laid_out), frame) => {
                    let had = document.rungs.len();
                    document.rungs.extend(frame.iter().flat_map(|frame| frame.rungs(kind)));
                    let why = laid_out.missing.iter().filter(|missing| missing.ladder == kind);
                    let mut why: Vec<String> = why.map(|missing| missing.reason.clone()).collect();
                    if document.rungs.len() == had && why.is_empty() {
                        why.push(format!("{reason}, and the frame that was to tell says nothing of it"));
                    }
                    why.into_iter().for_each(|reason| miss(kind, reason));
                }
                (None, None, _) => miss(
                    kind,
                    format!(
                        "{reason}; a job that asks for all `ladders`, and `forelight accuracy`, find out"
                    ),
                ),
            }
            continue;
        }
        if let (Err(reason), None) = (&noise, &frame) {
            miss(kind, format!("errors: {reason}"));
        }
        for settings in rungs {
            let of_frame = || frame.as_ref()?.error_like(kind, &settings);
            let error = error_with(settings.spp).or_else(of_frame);
            let pixels = settings.pixels() as f64 / asked.pixels() as f64;
            let profiles = with_samples(profiles, settings.spp);
            let total = calibrated(&enlarged(preview, pixels), &profiles, shared, None)?.job.total;
            document.rungs.push(AccuracyRung {
                ladder: kind,
                asked_for: settings == *asked,
                settings,
                work: total.work,
                cpu_seconds: total.cpu_seconds,
                error,
                worth_taking: false,
                next: None,
                measured: None,
            });
        }
    }
    document.mark(front_of_known(&document.points()));
    Ok(document)
}

/// Why nobody can say what a ladder takes, if so, of frames that share a cache or do not.
fn never(kind: LadderKind, shared: bool) -> Option<&'static str> {
    let is_of_cache = matches!(kind, LadderKind::Cache | LadderKind::Resolution);
    (shared && is_of_cache)
        .then_some("the frames share a cache, which is filled for its own accuracy and resolution")
}

/// Why the job's own profile does not say what a ladder takes that is not its own.
fn unknown(kind: LadderKind, asked: &RenderSettings) -> &'static str {
    match (kind, asked.integrator) {
        (LadderKind::Ambient, Integrator::Ambient) => "the job is profiled with an irradiance cache",
        (LadderKind::CachedSamples, _) => "the job is profiled without an irradiance cache",
        (LadderKind::Ambient, Integrator::Path) => "the job is profiled with the integrator path",
        (LadderKind::Path, _) => "the job is profiled with the integrator ambient",
        (LadderKind::Cache, _) => "the job is profiled at its own accuracy; no other is planned",
        (LadderKind::Divisions, _) => "the job is profiled with its own gathers",
        (LadderKind::Resolution, _) => "the job's cache is planned at its own resolution",
    }
}

/// What every profile says of its frame's error, or in words why they do not.
fn images(profiles: &[MeasuredProfile]) -> Result<Vec<ImageNoise>, String> {
    let image = |profile: &MeasuredProfile| {
        let settled =
            "pixels were profiled before the irradiance cache was filled, or with one camera sample";
        if profile.result.noise.is_empty() {
            return Err(settled.to_owned());
        }
        let cells = profile.result.noise.iter().map(|cell| NoiseCell {
            pixels: cell.pixels.into(),
            samples: cell
                .samples
                .iter()
                .map(|sample| PixelNoise {
                    brightness: sample.brightness.into(),
                    drops: sample.drops.iter().map(|&drop| drop.into()).collect(),
                    bias_square: 0.0,
                })
                .collect(),
        });
        ImageNoise::new(cells.collect()).map_err(|error| error.to_string())
    };
    profiles.iter().map(image).collect()
}

/// Root mean square over the profiled frames.
fn error(images: &[ImageNoise], spp: u32) -> Option<ImageError> {
    let frames: Vec<MeanSquare> = images.iter().map(|image| image.at(spp)).collect();
    let ErrorQuantiles { p05, p50, p80, p95 } = MeanSquare::mean(&frames)?.error(Calibration::NONE);
    Some(ImageError { p05, p50, p80, p95 })
}

/// The preview of an image of so many times the pixels.
fn enlarged(preview: &PreviewResult, factor: f64) -> PreviewResult {
    let mut preview = preview.clone();
    for frame in &mut preview.frames {
        for pixels in frame.pixels.iter_mut().chain([&mut frame.background]) {
            // What is shown stays shown. Saturates at the end of the range, as float to integer does.
            let least = u32::from(*pixels > 0);
            *pixels = ((f64::from(*pixels) * factor).round() as u32).max(least);
        }
    }
    preview
}

/// The profiles as if their pixels had had so many camera samples.
pub(crate) fn with_samples(profiles: &[MeasuredProfile], spp: u32) -> Vec<MeasuredProfile> {
    let mut profiles = profiles.to_vec();
    for profile in &mut profiles {
        let had = profile.spp.max(1);
        let factor = f64::from(spp) / f64::from(had);
        let growth = profile.result.uncovered.map_or(1.0, |gathers| gathers.growth(had, spp));
        let scale = |work: &mut u64, extra: &mut u64, cpu_nanos: &mut u64, rays: &mut [u64; 7]| {
            let had = Cost { work: *work, cpu_nanos: *cpu_nanos, rays: *rays };
            let cost = had.with_samples(factor, *extra, growth);
            (*work, *cpu_nanos, *rays) = (cost.work, cost.cpu_nanos, cost.rays);
            *extra = (*extra as f64 * growth).round() as u64;
        };
        for sample in &mut profile.result.samples {
            scale(&mut sample.work, &mut sample.extra_work, &mut sample.cpu_nanos, &mut sample.rays);
        }
        for sample in &mut profile.result.shared_samples {
            scale(&mut sample.work, &mut sample.extra_work, &mut sample.cpu_nanos, &mut sample.rays);
        }
        profile.spp = spp;
    }
    profiles
}
