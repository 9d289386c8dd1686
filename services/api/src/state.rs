use parking_lot::Mutex;
use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::{JobId, ProblemKind, Timestamp, TrackRecord};
use forelight_store::tokens::Principal;
use forelight_store::{IdempotencyKey, Projection, Store, project};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use crate::clock::Clock;
use crate::config::{Evidence, Limits};
use crate::costly::Costly;
use crate::error::{ApiError, ApiResult};
use crate::feed::Feed;
use crate::inspector::Inspector;
use crate::low_priority::LowPriority;
use crate::metrics::Metrics;
use crate::oidc::SignIn;
use crate::output_root::OutputRoot;
use crate::quotas::Quotas;
use crate::resources::dashboard::WholeFarm;
use crate::rights::Rights;
use crate::shared::{Changes, Shared};
use crate::sign_in::SignIns;
use crate::summaries::Summaries;
use crate::uploads::Reserved;

/// State shared by all handlers. Cheap to clone.
#[derive(Clone)]
pub(crate) struct App {
    pub store: Store,
    /// Where everything runs that no worker waits for.
    pub low_priority: LowPriority,
    pub clock: Arc<dyn Clock>,
    /// Held for reading from the instant that a lease's end counts from until that end is written. A step of the
    /// clock holds it for writing, so that it moves all ends.
    pub clock_steps: Arc<tokio::sync::RwLock<()>>,
    pub lease_ttl: Duration,
    /// Whether people reach the service over TLS.
    pub is_over_tls: bool,
    /// See [`crate::Config::public_origin`].
    pub public_origin: Option<Arc<str>>,
    /// Signs people in through the studio's provider, if there is one.
    pub sign_in: Option<Arc<SignIn>>,
    pub session_lifetime: Duration,
    pub sign_ins: Arc<SignIns>,
    /// The rights by which requests live that are under way.
    pub rights: Arc<Rights>,
    /// Changes whenever a webhook is to be told something besides events.
    pub webhooks_changed: Arc<watch::Sender<u64>>,
    /// Canonical paths of the bundle roots.
    pub bundle_roots: Arc<[PathBuf]>,
    /// Where images are written for jobs that ask for it.
    pub output_root: Option<OutputRoot>,
    pub limits: Arc<Limits>,
    pub evidence: Evidence,
    pub metrics: Arc<Metrics>,
    /// Cancelled when the service stops. All waits then end.
    pub stopping: CancellationToken,
    pub inspector: Arc<Inspector>,
    /// Jobs for which the conductor may have something to do.
    pub conductor: mpsc::UnboundedSender<JobId>,
    pub in_flight: InFlight,
    /// Held while the farm deletes what is past its time.
    pub pruning: Arc<tokio::sync::Mutex<()>>,
    pub costly: Arc<Costly>,
    pub quotas: Quotas,
    /// Disk space that uploads have reserved.
    pub reserved: Reserved,
    pub feed: Arc<Feed>,
    pub dashboard: Arc<Shared<WholeFarm>>,
    pub summaries: Arc<Summaries>,
    /// Expected course of the open bookings.
    pub projected: Arc<Shared<Projection>>,
    /// Totals of the track record, over all finished frames.
    pub record: Arc<Shared<TrackRecord>>,
    /// When a person last changed something, and when a plan was stored.
    pub changes: Changes,
    /// The OpenAPI document, which is made when it is first asked for.
    pub openapi: fn() -> &'static str,
}

impl App {
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// Ends the requests whose rights have ended. Whoever ends a right calls this before answering.
    pub async fn end_rights(&self) {
        if let Err(error) = self.rights.look(&self.store, self.now()).await {
            tracing::warn!(%error, "which rights have ended could not be read; the next look tries again");
        }
    }

    /// The same service, for what people ask: it has connections to the database that nothing else needs.
    pub fn for_people(&self) -> Self {
        Self { store: self.store.for_people(), ..self.clone() }
    }

    /// The same service, for what it does by itself, with connections to the database of its own.
    pub fn for_service(&self) -> Self {
        Self { store: self.store.for_service(), ..self.clone() }
    }

    /// The store for changes by this caller. The audit names him.
    pub fn by(&self, caller: &Principal) -> Store {
        self.store.acting_for(caller.actor())
    }

    /// Expected course of the open bookings. On a large farm, it may be a few seconds old.
    pub async fn projection(&self) -> ApiResult<Arc<Projection>> {
        let read = async {
            let (bookings, parts) = (self.store.open_bookings().await?, self.store.open_cache_parts().await?);
            Ok(project(&bookings, &parts, self.now()))
        };
        self.projected.get(self.changes.last(), read).await
    }
}

/// Idempotency keys of requests in progress. The store makes repetition harmless; this only keeps an
/// impatient client from having its bundle checked twice at the same time.
#[derive(Clone, Default)]
pub(crate) struct InFlight(Arc<Mutex<HashSet<OwnedKey>>>);

type OwnedKey = ([u8; 32], String);

pub(crate) struct InFlightGuard {
    keys: InFlight,
    key: OwnedKey,
}

impl InFlight {
    /// Takes a key, or returns an error if another request holds it.
    pub fn enter(&self, key: Option<&IdempotencyKey>) -> ApiResult<Option<InFlightGuard>> {
        let Some(key) = key else { return Ok(None) };
        let key = (key.principal, key.key.clone());
        let mut keys = self.0.lock();
        if !keys.insert(key.clone()) {
            return Err(ApiError::new(
                ProblemKind::IdempotencyInFlight,
                "a request with this idempotency key has not been answered yet; repeat it later",
            )
            .retry_after(1));
        }
        Ok(Some(InFlightGuard { keys: self.clone(), key }))
    }
}

impl Drop for InFlightGuard {
    fn drop(&mut self) {
        self.keys.0.lock().remove(&self.key);
    }
}
