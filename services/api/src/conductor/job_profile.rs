//! What is kept of what workers measured of a job: all that later questions about its cost rest on.

use forelight_protocol::{Job, PreviewResult};
use forelight_store::{MeasuredProfile, PlannedCache, Store, StoreError};

use super::accuracy::with_samples;
use super::sharing::SharedWay;

/// A profiled job.
#[derive(Clone, Debug)]
pub(crate) struct JobProfile {
    pub preview: PreviewResult,
    /// At the camera samples that the job is rendered with: one that was given a time is profiled with others.
    pub profiles: Vec<MeasuredProfile>,
    /// The plan of the irradiance cache that its frames share, if they do.
    pub shared: PlannedCache,
}

impl JobProfile {
    /// Of this job; `None` until it is profiled.
    pub async fn read(store: &Store, job: &Job) -> Result<Option<Self>, StoreError> {
        let Some(preview) = store.preview_result(job.id).await? else { return Ok(None) };
        let profiles = store.profile_results(job.id).await?.filter(|profiles| !profiles.is_empty());
        let Some(profiles) = profiles else { return Ok(None) };
        let profiles = with_samples(&profiles, job.settings.spp);
        let quote = store.forecast(job.id).await?;
        let shares = quote.and_then(|quote| quote.cache).is_some_and(|cache| cache.shared);
        let shared = if shares { store.planned_cache(job.id).await? } else { PlannedCache::NotAsked };
        Ok(Some(Self { preview, profiles, shared }))
    }

    /// How its frames come by their irradiance caches, if it is not each by its own.
    pub(super) fn way(&self) -> Option<SharedWay<'_>> {
        SharedWay::of(&self.shared)
    }
}
