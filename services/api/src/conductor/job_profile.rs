//! Measurements of a job, and the answers about its cost that need nothing else.

use forelight_protocol::{
    AccuracyDoc, AccuracyRung, Explanation, Job, JobSettings, PreviewResult, ProfileResult, RenderSettings,
};
use forelight_quote::{Measured, MeasuredProfile, explain_sampled, with_samples, with_samples_for_error};
use forelight_store::{PlannedCache, ShotProfiles, Store, StoreError};

use super::{AdvanceError, compute};

#[derive(Clone, Debug)]
pub(crate) struct JobProfile {
    preview: PreviewResult,
    /// Profiles at the camera samples that were chosen for the job, which may be profiled at others.
    profiles: Vec<MeasuredProfile>,
    /// Plan of the shared irradiance cache. Empty if frames share none.
    shared: PlannedCache,
    settings: RenderSettings,
}

impl JobProfile {
    /// Reads the profile. `None` until the job is profiled, and for a job of another renderer, whose pixels
    /// are not profiled.
    pub async fn read(store: &Store, job: &Job) -> Result<Option<Self>, StoreError> {
        let Some(settings) = job.settings.own() else { return Ok(None) };
        let Some(preview) = store.preview_result(job.id).await? else { return Ok(None) };
        let profiles = store.profile_results(job.id).await?.filter(|profiles| !profiles.is_empty());
        let Some(profiles) = profiles else { return Ok(None) };
        let quote = store.forecast(job.id).await?;
        let chosen = quote.as_ref().and_then(|quote| quote.chosen_spp);
        let settings = RenderSettings { spp: chosen.unwrap_or(settings.spp), ..settings.clone() };
        let profiles = match job.error_target {
            Some(_) => {
                let Ok(profiles) = with_samples_for_error(&profiles) else { return Ok(None) };
                profiles
            }
            None => with_samples(&profiles, settings.spp),
        };
        let shares = quote.and_then(|quote| quote.cache).is_some_and(|cache| cache.shared);
        let shared = if shares { store.planned_cache(job.id).await? } else { PlannedCache::NotAsked };
        Ok(Some(Self { preview, profiles, shared, settings }))
    }

    fn measured(&self) -> Measured<'_> {
        Measured::new(&self.preview, &self.profiles).with_cache(self.shared.plan())
    }

    pub async fn qualities(self) -> Result<AccuracyDoc, AdvanceError> {
        compute(move || Ok(self.measured().qualities(&self.settings)?)).await
    }

    /// The qualities that the job could have instead. None if the profile does not say.
    pub async fn rungs(self) -> Result<Vec<AccuracyRung>, StoreError> {
        match self.qualities().await {
            Ok(document) => Ok(document.rungs),
            Err(AdvanceError::Store(error)) => Err(error),
            Err(AdvanceError::Hopeless(reason)) => {
                tracing::debug!(reason, "no other qualities");
                Ok(Vec::new())
            }
        }
    }
}

/// Why a job, or one of its frames, costs what it costs. `None` until the job is profiled.
pub(crate) async fn explanation(
    store: &Store,
    job: &Job,
    frame: Option<u32>,
) -> Result<Option<Explanation>, AdvanceError> {
    let settings = match &job.settings {
        JobSettings::Own(_) => {
            let Some(profile) = JobProfile::read(store, job).await? else { return Ok(None) };
            let explain = move || Ok(Some(profile.measured().explain(&profile.settings, frame)?));
            return compute(explain).await;
        }
        JobSettings::Shot(settings) => settings.clone(),
    };
    let Some(preview) = store.preview_result(job.id).await? else { return Ok(None) };
    let Some(profiles) = store.shot_profiles(job.id).await? else { return Ok(None) };
    compute(move || {
        Ok(match profiles {
            ShotProfiles::Samples(profiles) if profiles.is_empty() => None,
            ShotProfiles::Samples(profiles) => Some(explain_sampled(&preview, &profiles, &settings, frame)?),
            ShotProfiles::Pixels(profiles) => {
                let profiles = of_pixels(profiles, settings.samples);
                Some(Measured::new(&preview, &profiles).explain_shot(&settings, frame)?)
            }
        })
    })
    .await
}

/// Pixels that another renderer profiled.
pub(crate) fn of_pixels(profiles: Vec<(ProfileResult, f64)>, samples: Option<u32>) -> Vec<MeasuredProfile> {
    let spp = samples.unwrap_or(1);
    let profile = |(result, speed)| MeasuredProfile::of_renderer(result, speed, spp);
    profiles.into_iter().map(profile).collect()
}
