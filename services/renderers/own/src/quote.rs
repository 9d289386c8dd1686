//! An offline quote: the steps of a farm, on this machine alone.

use crate::error::ShotError;
use crate::profile::{Observer, ProfiledFrame, count_frames, profile_frame, stratum_ids};
use crate::quote_options::QuoteOptions;
use crate::results::{preview_result, profile_result};
use crate::shared_cache::{SharedPlan, profile_shared};
use crate::shot::OwnShot;
use forelight_protocol::{
    CacheSharing, ForecastDoc, PreviewResult, ProfileArtifacts, QuotedShot, RenderSettings, Spent,
};
use forelight_quote::{Measured, MeasuredProfile, SharedCache, frames_to_profile};
use forelight_renderer::artifact_name;

/// A quote, and the measurements behind it.
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
    /// The measurements behind the quote, with an irradiance cache for each frame.
    pub fn measured(&self) -> Measured<'_> {
        measured(&self.preview, &self.profiles, &self.options)
    }

    /// The cost of making the quote.
    pub fn spent(&self) -> Spent {
        self.profiled.iter().map(ProfiledFrame::spent).fold(self.preview.spent, Spent::plus)
    }

    /// The part of [`Quote::spent`] that renders cannot reuse: previews, cache plans, and setting up the
    /// profiled frames. See [`ProfiledFrame::spent_for_good`].
    pub fn spent_for_good(&self) -> Spent {
        self.profiled.iter().map(ProfiledFrame::spent_for_good).fold(self.preview.spent, Spent::plus)
    }

    /// The quote with caches built as `asked`. A `planned` shared cache means measuring the pixels again.
    pub fn with_sharing(
        &self,
        shot: &OwnShot,
        settings: &RenderSettings,
        asked: CacheSharing,
        planned: Option<SharedPlan>,
    ) -> Result<ForecastDoc, ShotError> {
        let mut profiles = self.profiles.clone();
        if let Some(plan) = &planned {
            for (profile, profiled) in profiles.iter_mut().zip(&self.profiled) {
                profile_shared(shot, profiled, settings, &self.options, plan.cache.clone())?
                    .add_to(&mut profile.result);
            }
        }
        let plan = planned.map(|plan| plan.result(|bytes| artifact_name(&bytes)));
        let shared = plan.as_ref().map(|plan| SharedCache { plan, node_speed: 1.0 });
        let measured = Measured { profiles: &profiles, shared, ..self.measured() };
        let corrections = self.options.corrections.as_ref();
        let quote = forelight_quote::quote(asked, settings, &measured, corrections)?;
        Ok(quote.job.document(quoted_shot(shot, settings), quote.frames))
    }

    /// The preview of the frames, as protocol data.
    pub fn preview(&self) -> &PreviewResult {
        &self.preview
    }

    /// Work of each pixel of one of the quote's frames, in row order. See [`Measured::pixel_work`].
    pub fn pixel_work(
        &self,
        shot: &OwnShot,
        settings: &RenderSettings,
        frame: u32,
        probability: Option<f64>,
    ) -> Result<Option<Vec<f64>>, ShotError> {
        let Some(work) = self.measured().pixel_work(frame, probability)? else { return Ok(None) };
        let strata = shot.info().strata.iter().map(|shown| work.of(shown.object, shown.material));
        let by_id: Vec<f64> = strata.chain([work.of_background()]).collect();
        let ids = stratum_ids(&shot.frame(frame, settings)?.preview()?.preview);
        Ok(Some(ids.into_iter().map(|id| by_id[id as usize]).collect()))
    }
}

/// Makes the quote of these frames (ascending): previews all, profiles a few, estimates all.
pub fn quote(
    shot: &OwnShot,
    frames: &[u32],
    settings: &RenderSettings,
    options: &QuoteOptions,
    observer: &dyn Observer,
) -> Result<Quote, ShotError> {
    let info = shot.info();
    let counted = count_frames(shot, frames, settings, observer)?;
    let preview = preview_result(info, frames, settings, &counted);
    let mut chosen = frames_to_profile(&preview, options.strategy, options.profile_frames)?;
    let mut profiles: Vec<MeasuredProfile> = Vec::with_capacity(chosen.len());
    let mut profiled: Vec<ProfiledFrame> = Vec::with_capacity(chosen.len());
    while !chosen.is_empty() {
        let all = profiled.len() + chosen.len();
        for frame in chosen {
            let found = profile_frame(shot, frame, settings, options, observer)?;
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
    let document = forecast.job.document(quoted_shot(shot, settings), forecast.frames);
    Ok(Quote { document, profiled, options: *options, preview, profiles })
}

fn measured<'a>(
    preview: &'a PreviewResult,
    profiles: &'a [MeasuredProfile],
    options: &QuoteOptions,
) -> Measured<'a> {
    Measured { strategy: options.strategy, ..Measured::new(preview, profiles) }
}

fn quoted_shot(shot: &OwnShot, settings: &RenderSettings) -> QuotedShot {
    QuotedShot { scene: shot.info().summary.digest, renderer: None, settings: settings.clone().into() }
}
