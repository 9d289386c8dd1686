//! The quote of a shot, made on this machine alone: the steps of a farm, one after the other.

use crate::profile::{Observer, ProfiledFrame, ShotError, count_frames, profile_frame, stratum_ids};
use crate::renderer::Renderer;
use crate::shared_cache::{SharedPlan, profile_shared};
use crate::tasks::{artifact_name, preview_result, profile_result};
use forelight_forecast::{Corrections, Strategy};
use forelight_protocol::{
    CacheSharing, ForecastDoc, PreviewResult, ProfileArtifacts, QuotedShot, RenderSettings, Spent,
};
use forelight_quote::{Measured, MeasuredProfile, SharedCache, frames_to_profile};

/// How a quote is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuoteOptions {
    /// Pixels to profile per profiled frame.
    pub samples: u32,
    /// Frames to profile at most, at least 1. `None`: as many as pay ([`Measured::more_to_profile`]).
    pub profile_frames: Option<usize>,
    /// Seed of the choice of pixels.
    pub seed: u64,
    /// How pixels are chosen, and how their costs are expanded to the frame.
    pub strategy: Strategy,
    /// What past jobs of the same renderer and class of features teach of the quantiles.
    pub corrections: Option<Corrections>,
}

impl Default for QuoteOptions {
    fn default() -> Self {
        Self { samples: 256, profile_frames: None, seed: 0, strategy: Strategy::Snapshot, corrections: None }
    }
}

/// A quote, and what it was made from.
#[derive(Debug, Clone)]
pub struct Quote {
    /// The quote.
    pub document: ForecastDoc,
    /// The profiled frames, ascending. Renders can take over their pixels.
    pub profiled: Vec<ProfiledFrame>,
    /// How the quote was made.
    pub options: QuoteOptions,
    preview: PreviewResult,
    profiles: Vec<MeasuredProfile>,
}

impl Quote {
    /// What the quote rests on, with an irradiance cache for each frame.
    pub fn measured(&self) -> Measured<'_> {
        measured(&self.preview, &self.profiles, &self.options)
    }

    /// The cost of making the quote.
    pub fn spent(&self) -> Spent {
        self.profiled.iter().map(ProfiledFrame::spent).fold(self.preview.spent, Spent::plus)
    }

    /// The part of [`Quote::spent`] that later renders cannot take over: previews, with the plans of irradiance caches,
    /// and setting up the profiled frames; see [`ProfiledFrame::spent_for_good`].
    pub fn spent_for_good(&self) -> Spent {
        self.profiled.iter().map(ProfiledFrame::spent_for_good).fold(self.preview.spent, Spent::plus)
    }

    /// The quote with the irradiance caches built as `asked`. `planned` is the shared cache's plan, if it was planned. The
    /// profiled pixels are then measured again beside it.
    pub fn with_sharing(
        &self,
        renderer: &dyn Renderer,
        settings: &RenderSettings,
        asked: CacheSharing,
        planned: Option<SharedPlan>,
    ) -> Result<ForecastDoc, ShotError> {
        let mut profiles = self.profiles.clone();
        if let Some(plan) = &planned {
            for (profile, profiled) in profiles.iter_mut().zip(&self.profiled) {
                profile_shared(renderer, profiled, settings, &self.options, plan.cache.clone())?
                    .add_to(&mut profile.result);
            }
        }
        let plan = planned.map(|plan| plan.result(|bytes| artifact_name(&bytes)));
        let shared = plan.as_ref().map(|plan| SharedCache { plan, node_speed: 1.0 });
        let measured = Measured { profiles: &profiles, shared, ..self.measured() };
        let corrections = self.options.corrections.as_ref();
        let quote = forelight_quote::quote(asked, settings, &measured, corrections)?;
        Ok(quote.job.document(quoted_shot(renderer, settings), quote.frames))
    }

    /// The preview of the frames, in the terms of the wire.
    pub fn preview(&self) -> &PreviewResult {
        &self.preview
    }

    /// Work of each pixel of one of the quote's frames, in row order: see [`Measured::pixel_work`].
    pub fn pixel_work(
        &self,
        renderer: &dyn Renderer,
        settings: &RenderSettings,
        frame: u32,
        probability: Option<f64>,
    ) -> Result<Option<Vec<f64>>, ShotError> {
        let Some(work) = self.measured().pixel_work(frame, probability)? else { return Ok(None) };
        let strata = renderer.info().strata.iter().map(|shown| work.of(shown.object, shown.material));
        let by_id: Vec<f64> = strata.chain([work.of_background()]).collect();
        let ids = stratum_ids(&renderer.frame(frame, settings)?.preview()?.preview);
        Ok(Some(ids.into_iter().map(|id| by_id[id as usize]).collect()))
    }
}

/// Makes the quote of these frames (ascending): previews all of them, profiles a few, estimates all.
pub fn quote(
    renderer: &dyn Renderer,
    frames: &[u32],
    settings: &RenderSettings,
    options: &QuoteOptions,
    observer: &dyn Observer,
) -> Result<Quote, ShotError> {
    let info = renderer.info();
    let counted = count_frames(renderer, frames, settings, observer)?;
    let preview = preview_result(info, frames, settings, &counted);
    let mut chosen = frames_to_profile(&preview, options.strategy, options.profile_frames)?;
    let mut profiles: Vec<MeasuredProfile> = Vec::with_capacity(chosen.len());
    let mut profiled: Vec<ProfiledFrame> = Vec::with_capacity(chosen.len());
    while !chosen.is_empty() {
        let all = profiled.len() + chosen.len();
        for frame in chosen {
            let found = profile_frame(renderer, frame, settings, options, observer)?;
            let profile = artifact_name(&found.profile.to_bytes());
            let artifacts = ProfileArtifacts { profile, preview_png: None };
            let result = profile_result(info, settings, &found, artifacts);
            let measured = MeasuredProfile::new(result, 1.0, settings.spp);
            profiles.push(MeasuredProfile { expansion: found.expansion.clone(), ..measured });
            profiled.push(found);
            observer.profiled(profiled.len(), all);
        }
        profiles.sort_by_key(|profile| profile.result.frame);
        profiled.sort_by_key(|profiled| profiled.frame);
        chosen = match options.profile_frames {
            Some(_) => Vec::new(),
            None => measured(&preview, &profiles, options).more_to_profile()?,
        };
    }
    let forecast = measured(&preview, &profiles, options).quote(options.corrections.as_ref())?;
    let document = forecast.job.document(quoted_shot(renderer, settings), forecast.frames);
    Ok(Quote { document, profiled, options: *options, preview, profiles })
}

fn measured<'a>(
    preview: &'a PreviewResult,
    profiles: &'a [MeasuredProfile],
    options: &QuoteOptions,
) -> Measured<'a> {
    Measured { strategy: options.strategy, ..Measured::new(preview, profiles) }
}

fn quoted_shot(renderer: &dyn Renderer, settings: &RenderSettings) -> QuotedShot {
    QuotedShot { scene: renderer.info().summary.digest, settings: settings.clone() }
}
