//! What every handler can reach.

use parking_lot::Mutex;
use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::{JobId, ProblemKind, Timestamp};
use forelight_store::{IdempotencyKey, Store};
use tokio::sync::{Semaphore, mpsc};
use tokio_util::sync::CancellationToken;

use crate::answer_cache::AnswerCache;
use crate::clock::Clock;
use crate::config::Limits;
use crate::error::ApiError;
use crate::metrics::Metrics;

/// What every handler can reach. Cheap to clone.
#[derive(Clone)]
pub(crate) struct App {
    pub store: Store,
    pub clock: Arc<dyn Clock>,
    pub lease_ttl: Duration,
    /// Canonical paths.
    pub bundle_roots: Arc<[PathBuf]>,
    pub limits: Arc<Limits>,
    pub metrics: Arc<Metrics>,
    /// Cancelled when the service is to stop: whoever waits for something stops waiting.
    pub stopping: CancellationToken,
    /// Bounds how many bundles are loaded at once: each takes memory and a processor.
    pub checks: Arc<Semaphore>,
    /// Jobs for which the conductor may have something to do.
    pub conductor: mpsc::UnboundedSender<JobId>,
    pub in_flight: InFlight,
    /// Answers about plans.
    pub answers: Arc<AnswerCache>,
    /// When the service was started.
    pub started: Timestamp,
    pub openapi: Arc<str>,
}

impl App {
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }
}

/// The idempotency keys of requests that are being worked on in this process.
///
/// Not what makes repetition harmless (the store does that, in the creating transaction), but what
/// saves a client that repeats impatiently from having its bundle checked twice at the same time.
#[derive(Clone, Default)]
pub(crate) struct InFlight(Arc<Mutex<HashSet<OwnedKey>>>);

/// The hash of a client's token, and the key that it chose.
type OwnedKey = ([u8; 32], String);

/// Holds a key until the request is answered or dropped.
pub(crate) struct InFlightGuard {
    keys: InFlight,
    key: OwnedKey,
}

impl InFlight {
    /// Takes a key, or says that another request has it.
    pub fn enter(&self, key: Option<&IdempotencyKey>) -> Result<Option<InFlightGuard>, ApiError> {
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
