//! The ladders of a job.
//!
//! *Camera samples*: a profiled pixel costs in proportion to its samples; records and fixed costs stay the
//! same. So every rung is the job's forecast with scaled costs. The error follows from the variance between
//! the camera samples of the profiled pixels, frame by frame.
//!
//! *Resolution*: each stratum has more or fewer pixels, with the cost and the error of the profiled ones.
//!
//! The profile cannot price other integrators or gathers. With an irradiance cache it also lacks the image's
//! error, because pixels are profiled before the cache is filled, and the records of other accuracies and
//! resolutions. If the job asks for these ladders, one frame was profiled with such settings too. Otherwise
//! they are listed as missing.

use forelight_protocol::{
    AccuracyDoc, AccuracyRung, Integrator, LadderKind, MissingLadder, PreviewResult, RenderSettings,
};

use super::ladder::{is_own, ladder, mark};
use super::noise::Noise;
use super::one_frame::{Job, OneFrame};
use crate::error::QuoteError;
use crate::measured::Measured;
use crate::samples::with_samples;

struct Known<'a> {
    asked: &'a RenderSettings,
    measured: &'a Measured<'a>,
    noise: Noise,
    /// Ladders that were profiled in one frame, if the job asked for them.
    profiled: Option<&'a AccuracyDoc>,
    /// The same for all frames. `None` if its costs are too small to compare.
    frame: Option<OneFrame<'a>>,
}

/// Rungs of a ladder, and why some are missing.
type Rungs = (Vec<AccuracyRung>, Vec<String>);

impl Measured<'_> {
    /// The ladders of a job with the settings `asked`, as far as its profiles know them. The cost of building
    /// a shared cache is not included.
    pub fn qualities(&self, asked: &RenderSettings) -> Result<AccuracyDoc, QuoteError> {
        let whole = self.quote(None)?;
        let mut document = AccuracyDoc {
            frames: self.preview.frames.len() as u32,
            settings: asked.clone(),
            rungs: Vec::new(),
            missing: Vec::new(),
            profiled: whole.job.profiled,
            spent: whole.job.spent,
            calibrated: whole.job.calibrated,
        };
        let noise = Noise::of(self.profiles);
        let profiled = self.profiles.iter().find_map(|profile| profile.result.ladders.as_deref());
        let mut frame = None;
        if let Some(profiled) = profiled {
            document.profiled.pixels = document.profiled.pixels.saturating_add(profiled.profiled.pixels);
            // The frame built its own cache.
            let total = match self.shared {
                Some(_) => self.with_cache(None).quote(None)?.job.total,
                None => whole.job.total,
            };
            let job = Job { work: total.work, cpu_seconds: total.cpu_seconds, error: noise.error(asked.spp) };
            frame = OneFrame::new(profiled, job);
        }
        let known = Known { asked, measured: self, noise, profiled, frame };
        for kind in LadderKind::ALL {
            let (rungs, reasons) = match ladder(kind, asked) {
                Err(reason) => (Vec::new(), vec![reason]),
                Ok(rungs) if is_own(kind, asked) => known.own(kind, rungs)?,
                Ok(_) => known.other(kind),
            };
            document.rungs.extend(rungs);
            let missing = reasons.into_iter().map(|reason| MissingLadder { ladder: kind, reason });
            document.missing.extend(missing);
        }
        mark(&mut document);
        Ok(document)
    }
}

impl Known<'_> {
    /// A ladder from the job's profiles.
    fn own(&self, kind: LadderKind, rungs: Vec<RenderSettings>) -> Result<Rungs, QuoteError> {
        let mut missing = Vec::new();
        if let (Some(reason), None) = (self.noise.missing(), &self.frame) {
            missing.push(format!("errors: {reason}"));
        }
        let rung = |settings: RenderSettings| {
            let known = self.frame.as_ref().and_then(|frame| frame.rung(kind, &settings));
            // The job's profiles know what denoising takes, but only at the settings asked for.
            if let Some(known) = known.filter(|known| known.denoised_error.is_some()) {
                return Ok(AccuracyRung { error: self.noise.error(settings.spp).or(known.error), ..known });
            }
            let of_frame = || self.frame.as_ref()?.error_like(kind, &settings);
            let error = self.noise.error(settings.spp).or_else(of_frame);
            let pixels = settings.pixels() as f64 / self.asked.pixels() as f64;
            let profiles = with_samples(self.measured.profiles, settings.spp);
            let preview = enlarged(self.measured.preview, pixels);
            let measured = Measured { preview: &preview, profiles: &profiles, ..*self.measured };
            let total = measured.quote(None)?.job.total;
            Ok(AccuracyRung {
                ladder: kind,
                asked_for: settings == *self.asked,
                settings,
                work: total.work,
                cpu_seconds: total.cpu_seconds,
                error,
                denoised_error: None,
                worth_taking: false,
                next: None,
                measured: None,
            })
        };
        Ok((rungs.into_iter().map(rung).collect::<Result<_, _>>()?, missing))
    }

    /// A ladder from the profile of one frame.
    fn other(&self, kind: LadderKind) -> Rungs {
        let reason = unknown(kind, self.asked);
        if let Some(reason) = never(kind, self.measured.shared.is_some()) {
            return (Vec::new(), vec![format!("{reason}; run `forelight accuracy` for this ladder")]);
        }
        let Some(profiled) = self.profiled else {
            let text = format!("{reason}; ask for all `ladders` with the job, or run `forelight accuracy`");
            return (Vec::new(), vec![text]);
        };
        let rungs: Vec<AccuracyRung> = self.frame.iter().flat_map(|frame| frame.rungs(kind)).collect();
        let reasons = profiled.missing.iter().filter(|missing| missing.ladder == kind);
        let mut reasons: Vec<String> = reasons.map(|missing| missing.reason.clone()).collect();
        if rungs.is_empty() && reasons.is_empty() {
            reasons.push(format!("{reason}, and the frame profiled for it has no cost either"));
        }
        (rungs, reasons)
    }
}

/// Why no profile can price the ladder if the frames share a cache.
fn never(kind: LadderKind, shared: bool) -> Option<&'static str> {
    let is_of_cache = matches!(kind, LadderKind::Cache | LadderKind::Resolution);
    (shared && is_of_cache)
        .then_some("the frames share a cache, which is filled for its own accuracy and resolution")
}

/// Why the job's own profile cannot price the ladder.
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

/// The preview of an image with `factor` times the pixels.
fn enlarged(preview: &PreviewResult, factor: f64) -> PreviewResult {
    let mut preview = preview.clone();
    for frame in &mut preview.frames {
        for pixels in frame.pixels.iter_mut().chain([&mut frame.background]) {
            // A visible stratum stays visible. Conversion to an integer saturates.
            let least = u32::from(*pixels > 0);
            *pixels = ((f64::from(*pixels) * factor).round() as u32).max(least);
        }
    }
    preview
}
