//! Moves jobs from one state to the next, where that is the service's work:
//!
//! ```text
//! previewing ──preview is there──► choose frames; make profile tasks, plan a shared cache ──► profiling
//! profiling  ──all are there──► estimate, plan, verify, book; make render and cache tasks ──► booked
//! profiling  ──all are there, the job is on hold──► estimate ──► quoted ──accepted──► plan, verify, book
//! ```
//!
//! The store makes the other steps: the first task handed out makes a job `rendering`, the last result
//! `done`. Events that the newest plan does not know start a new one (`replan`).
//!
//! *Idempotent*: every step reads the store, computes, and writes one transaction, which does nothing if the
//! job has left its state. So crashes, repeated advances and cancellations are harmless.
//!
//! There is one conductor and it does one thing at a time, so plans never compete.

pub(crate) mod answers;
pub(crate) mod book;
mod bookable;
mod budget_holds;
mod demands;
pub(crate) mod effects;
pub(crate) mod farm;
mod held_quotes;
pub(crate) mod job_profile;
#[cfg(test)]
pub(crate) mod made_up;
pub(crate) mod numbers;
mod qualities;
mod quantities;
mod replan;
mod risks;
pub(crate) mod settle;
pub(crate) mod waits;
mod watched;
pub(crate) mod what_if;

use parking_lot::Mutex;
use std::sync::Arc;

use forelight_forecast::Experience;
use forelight_forecast::Strategy;
use forelight_protocol::{
    AccuracyRung, Job, JobId, JobSettings, JobState, Money, Node, PreviewResult, RenderSettings, Within,
};
use forelight_quote::{
    Limit, Measured, MeasuredProfile, Most, Quote, QuoteBasis, QuoteError, QuoteKind, SharedCacheToBuild,
    Spreads, frames_to_profile, is_shared_cache_worth_planning, quote, quote_for_error, quote_sampled,
};
use forelight_store::{PlannedCache, ShotProfiles, Store, StoreError};

use self::job_profile::{JobProfile, of_pixels};
use self::watched::Watched;
use crate::clock::Clock;
use crate::metrics::Metrics;
use crate::shared::Changes;

/// Attempts to plan a job that other plans overtake, before it waits for the next round.
const ATTEMPTS: usize = 3;

pub(crate) struct Conductor {
    store: Store,
    clock: Arc<dyn Clock>,
    metrics: Arc<Metrics>,
    changes: Changes,
    watched: Mutex<Watched>,
}

#[derive(Debug, thiserror::Error)]
pub(crate) enum AdvanceError {
    /// The store failed, or the job changed meanwhile. Trying later may succeed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The job or the code is at fault. Trying again would fail the same way.
    #[error("{0}")]
    Hopeless(String),
}

impl From<QuoteError> for AdvanceError {
    fn from(error: QuoteError) -> Self {
        Self::Hopeless(error.to_string())
    }
}

impl Conductor {
    pub fn new(store: Store, clock: Arc<dyn Clock>, metrics: Arc<Metrics>, changes: Changes) -> Self {
        Self { store, clock, metrics, changes, watched: Mutex::default() }
    }

    /// After a plan was stored.
    fn note_plan(&self) {
        self.metrics.plans_stored.add(1);
        self.changes.by_plan();
    }

    pub async fn advance_all(&self) {
        match self.store.jobs_to_advance().await {
            Ok(jobs) => {
                for job in jobs {
                    self.advance(job).await;
                }
            }
            Err(error) => tracing::warn!(%error, "the list of jobs to advance could not be read"),
        }
    }

    /// Advances a job as far as possible. Errors are logged. If trying again is pointless, the job fails.
    pub async fn advance(&self, job: JobId) {
        let outcome = self.try_advance(job).await;
        self.settle(job, outcome).await;
    }

    async fn settle(&self, job: JobId, outcome: Result<(), AdvanceError>) {
        match outcome {
            Ok(()) => {}
            Err(AdvanceError::Store(error)) => {
                tracing::warn!(%job, %error, "the job does not advance yet")
            }
            Err(AdvanceError::Hopeless(reason)) => {
                tracing::error!(%job, reason, "the job cannot advance");
                if let Err(error) = self.store.fail_job(job, &reason, self.clock.now()).await {
                    tracing::warn!(%job, %error, "the job could not be marked as failed; the next round tries again");
                }
            }
        }
    }

    async fn try_advance(&self, id: JobId) -> Result<(), AdvanceError> {
        let job = self.store.job(id).await?;
        match job.state {
            JobState::Previewing => self.choose(&job).await,
            JobState::Profiling => self.forecast_and_book(&job).await,
            JobState::Quoted if !job.hold => self.book_accepted(&job).await,
            JobState::Quoted => {
                self.foresee_held_quote(id).await;
                Ok(())
            }
            JobState::Booked
            | JobState::Rendering
            | JobState::Done
            | JobState::Failed
            | JobState::Cancelled => Ok(()),
        }
    }

    async fn choose(&self, job: &Job) -> Result<(), AdvanceError> {
        let Some(preview) = self.store.preview_result(job.id).await? else { return Ok(()) };
        let most = job.profile_frames.map(|most| most as usize);
        let plan_cache = job.has_even_samples() && is_shared_cache_worth_planning(job.cache, &preview);
        let frames = compute(move || Ok(frames_to_profile(&preview, Strategy::Snapshot, most)?)).await?;
        tracing::info!(job = %job.id, ?frames, plan_cache, "frames to profile");
        Ok(self.store.start_profiling(job.id, &frames, plan_cache, self.clock.now()).await?)
    }

    async fn forecast_and_book(&self, job: &Job) -> Result<(), AdvanceError> {
        match &job.settings {
            JobSettings::Own(settings) => self.forecast_pixels_and_book(job, settings).await,
            JobSettings::Shot(_) => self.forecast_shot_and_book(job).await,
        }
    }

    /// Books a job of another renderer, which was measured as a few frames at few samples, or by a few pixels
    /// of a few frames.
    async fn forecast_shot_and_book(&self, job: &Job) -> Result<(), AdvanceError> {
        let Some(profiles) = self.store.shot_profiles(job.id).await? else { return Ok(()) };
        let Some(preview) = self.store.preview_result(job.id).await? else { return Ok(()) };
        let kind = match &profiles {
            ShotProfiles::Samples(profiles) => {
                profiles.first().map(|profile| QuoteKind::of_renderer(&profile.result.renderer))
            }
            ShotProfiles::Pixels(profiles) => profiles
                .first()
                .and_then(|(result, _)| result.renderer.as_ref())
                .map(|renderer| QuoteKind::of_pixels(renderer)),
        };
        let experience = self.experience(kind.as_ref()).await?;
        let samples = job.settings.samples();
        let quote = compute(move || {
            let corrections = experience.corrections();
            Ok(match profiles {
                ShotProfiles::Samples(profiles) => quote_sampled(&preview, &profiles, corrections.as_ref())?,
                ShotProfiles::Pixels(profiles) => {
                    let profiles = of_pixels(profiles, samples);
                    Measured::new(&preview, &profiles).quote(corrections.as_ref())?
                }
            })
        })
        .await?;
        let basis = kind.map(|kind| quote.basis(kind));
        self.book_at_last(job, &quote, basis.as_ref(), &[]).await
    }

    async fn forecast_pixels_and_book(
        &self,
        job: &Job,
        settings: &RenderSettings,
    ) -> Result<(), AdvanceError> {
        let Some(profiles) = self.store.profile_results(job.id).await? else { return Ok(()) };
        let Some(preview) = self.store.preview_result(job.id).await? else { return Ok(()) };
        let planned = self.store.planned_cache(job.id).await?;
        if planned == PlannedCache::Pending {
            return Ok(());
        }
        if job.profile_frames.is_none() && job.has_even_samples() {
            let (preview, profiles) = (preview.clone(), profiles.clone());
            let more = compute(move || Ok(Measured::new(&preview, &profiles).more_to_profile()?)).await?;
            if !more.is_empty() {
                tracing::info!(job = %job.id, frames = ?more, "more frames to profile: the forecast is not sure");
                return Ok(self.store.profile_more(job.id, &more, &planned).await?);
            }
        }
        let kind = QuoteKind::of(&profiles, settings);
        let experience = self.experience(kind.as_ref()).await?;
        let chosen = match (&job.within, job.error_target) {
            (Some(within), _) => {
                Chosen::Within(limit(within, job, self.nodes_for_plans(self.clock.now()).await?)?)
            }
            (None, Some(_)) => Chosen::ForError,
            (None, None) => Chosen::AsAsked,
        };
        let (asked, settings) = (job.clone(), settings.clone());
        let (quote, rungs) = compute(move || {
            quote_job((&asked, &settings), &preview, &profiles, &planned, &experience, chosen)
        })
        .await?;
        // Frames with a fixed amount of work do not show forecast errors. With an error target, they show those
        // of the noise, too.
        let basis = kind.filter(|_| job.has_even_samples()).map(|kind| quote.basis(kind));
        self.book_at_last(job, &quote, basis.as_ref(), &rungs).await
    }

    /// What past jobs of this kind taught. Nothing without a kind.
    async fn experience(&self, kind: Option<&QuoteKind>) -> Result<Experience, AdvanceError> {
        match kind {
            Some(kind) => Ok(self.store.experience(kind).await?),
            None => Ok(Experience::default()),
        }
    }

    /// Books a job whose quote was accepted. The quote stays as it is.
    async fn book_accepted(&self, job: &Job) -> Result<(), AdvanceError> {
        let Some((kept, frames)) = self.store.kept_quote(job.id).await? else { return Ok(()) };
        let shares = kept.cache.as_ref().is_some_and(|cache| cache.shared_cache.is_some());
        let planned = self.store.planned_cache(job.id).await?;
        let shared_cache = planned.plan().filter(|_| shares).and_then(|shared| {
            let plan = shared.plan;
            let records = plan.records.iter().map(|&count| u64::from(count)).sum();
            Some(SharedCacheToBuild { cache: plan.cache?, bytes: plan.bytes, records })
        });
        let measured = match job.has_even_samples() {
            true => JobProfile::read(&self.store, job).await?,
            false => None,
        };
        let rungs = match measured {
            Some(measured) => measured.rungs().await?,
            None => Vec::new(),
        };
        let unknown = Spreads { work: 0.0, cpu: 0.0 };
        let quote = Quote { job: kept, frames, spreads: (unknown, Vec::new()), shared_cache };
        self.book_at_last(job, &quote, None, &rungs).await
    }

    /// Books the job, or keeps the quote of a job on hold. Tries again if another plan comes first.
    async fn book_at_last(
        &self,
        job: &Job,
        quote: &Quote,
        basis: Option<&QuoteBasis>,
        rungs: &[AccuracyRung],
    ) -> Result<(), AdvanceError> {
        if job.hold {
            return self.keep_quote(job, quote, basis).await;
        }
        for _ in 0..ATTEMPTS {
            match self.book(job, quote, basis, rungs).await {
                // Overtaken by another plan or a cancellation: look again.
                Err(AdvanceError::Store(StoreError::Conflict(reason))) => {
                    tracing::info!(job = %job.id, reason, "the plan is made again");
                    let state = self.store.job(job.id).await?.state;
                    if !matches!(state, JobState::Profiling | JobState::Quoted) {
                        return Ok(());
                    }
                }
                other => return other,
            }
        }
        Ok(())
    }
}

/// How the camera samples of a job are chosen.
enum Chosen {
    AsAsked,
    Within(Limit),
    ForError,
}

fn quote_job(
    (job, settings): (&Job, &RenderSettings),
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
    planned: &PlannedCache,
    experience: &Experience,
    chosen: Chosen,
) -> Result<(Quote, Vec<AccuracyRung>), AdvanceError> {
    let corrections = experience.corrections();
    match chosen {
        Chosen::AsAsked => {}
        Chosen::Within(limit) => {
            return Ok((limit.quote(preview, profiles, corrections.as_ref())?, Vec::new()));
        }
        Chosen::ForError => {
            return Ok((quote_for_error(preview, profiles, corrections.as_ref())?, Vec::new()));
        }
    }
    let measured = Measured::new(preview, profiles).with_cache(planned.plan());
    let quote = quote(job.cache, settings, &measured, corrections.as_ref())?;
    if profiles.is_empty() {
        return Ok((quote, Vec::new()));
    }
    let shared = planned.plan().filter(|_| quote.shared_cache.is_some());
    let rungs = measured.with_cache(shared).qualities(settings)?.rungs;
    Ok((quote, rungs))
}

/// The limit of a job on a farm of these nodes. Money sets a limit only if a node has a price.
fn limit(within: &Within, job: &Job, nodes: Vec<Node>) -> Result<Limit, AdvanceError> {
    let most = match (within.cpu_micros, within.money) {
        (Some(micros), _) => Most::Seconds(micros as f64 * 1e-6),
        (None, Some(money)) if nodes.iter().any(|node| node.price_per_hour > Money(0)) => {
            Most::Money(money.micro_units(), nodes)
        }
        (None, Some(_)) => {
            let reason = "within: no node of the farm has a price, so an amount of money sets no limit: \
                          set the nodes' prices, or give a CPU time";
            return Err(AdvanceError::Hopeless(reason.to_owned()));
        }
        (None, None) => {
            return Err(AdvanceError::Hopeless(
                "within: it gives neither a time nor an amount of money".to_owned(),
            ));
        }
    };
    Ok(Limit { most, per: within.per, confidence: job.confidence })
}

/// Runs a long computation on its own thread, so that requests are still answered.
pub(crate) async fn compute<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, AdvanceError> + Send + 'static,
) -> Result<T, AdvanceError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(outcome) => outcome,
        Err(error) => Err(AdvanceError::Hopeless(format!("a computation failed: {error}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SystemClock;
    use forelight_protocol::{BundleSource, JobRequest, SceneDigest, SceneSummary, Timestamp};
    use forelight_store::{Answered, NewJob};

    #[tokio::test]
    async fn a_job_that_cannot_advance_fails_with_the_reason_and_is_not_asked_for_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let request: JobRequest = serde_json::from_value(
            serde_json::json!({"name": "a", "bundle": {"path": "/scenes/a"}, "frames": "0-3"}),
        )
        .unwrap();
        let scene = SceneSummary {
            name: "a".to_owned(),
            digest: SceneDigest([0; 32]),
            frames: 4,
            width: 8,
            height: 8,
            objects: 1,
            materials: 1,
            triangles: 1,
            frames_per_second: None,
        };
        let settings = request.settings.complete((8, 8)).into();
        let source = BundleSource::Path("/scenes/a".to_owned());
        let new = NewJob { request, scene, source, settings };
        let Answered::Fresh(job) = store.create_job(&new, None, Timestamp::now()).await.unwrap() else {
            panic!()
        };
        let conductor =
            Conductor::new(store.clone(), Arc::new(SystemClock::default()), Arc::default(), Changes::new());
        let busy = AdvanceError::Store(StoreError::Conflict("later".to_owned()));
        conductor.settle(job.id, Err(busy)).await;
        assert_eq!(store.jobs_to_advance().await.unwrap(), [job.id]);
        let reason = "the verifier refused the plan";
        conductor.settle(job.id, Err(AdvanceError::Hopeless(reason.to_owned()))).await;
        let failed = store.job(job.id).await.unwrap();
        assert_eq!((failed.state, failed.error.as_deref()), (JobState::Failed, Some(reason)));
        assert!(store.jobs_to_advance().await.unwrap().is_empty());
    }
}
