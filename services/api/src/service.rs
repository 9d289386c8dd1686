//! The running service: its start, what it does by itself, and its end.

use std::net::SocketAddr;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::JobId;
use forelight_store::{Store, StoreError};
use futures::FutureExt as _;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, mpsc};
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::clock::{Clock as _, SteadyClock};
use crate::conductor::Conductor;
use crate::config::Config;
use crate::connections::serve;
use crate::metrics::Metrics;
use crate::router::{openapi_yaml, router};
use crate::state::{App, InFlight};

/// How long requests that are being answered may take when the service stops.
const LAST_ANSWERS: Duration = Duration::from_secs(10);

/// Why the service does not run.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The data folder cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// Which address.
        address: SocketAddr,
        /// Why not.
        source: std::io::Error,
    },
    /// A bundle root is not there.
    #[error("bundle root {path}: {source}")]
    BundleRoot {
        /// Which one.
        path: String,
        /// Why not.
        source: std::io::Error,
    },
}

/// A running service. It stops when this is dropped; [`Service::shutdown`] waits for that.
pub struct Service {
    address: SocketAddr,
    store: Store,
    stopping: CancellationToken,
    tasks: Vec<JoinHandle<()>>,
}

impl Service {
    /// Opens the data folder, resumes what was under way, and serves. When this returns, the service can be reached.
    pub async fn start(config: Config) -> Result<Self, ServiceError> {
        let Config { data_dir, artifacts, artifacts_moved, listen, lease_ttl, bundle_roots, limits, clock } =
            config;
        let roots = bundle_roots
            .into_iter()
            .map(|root| {
                root.canonicalize()
                    .map_err(|source| ServiceError::BundleRoot { path: root.display().to_string(), source })
            })
            .collect::<Result<Arc<[_]>, _>>()?;
        let clock = Arc::new(SteadyClock::new(clock));
        let store = Store::open_with(&data_dir, &artifacts, artifacts_moved).await?;
        let extended = store.extend_leases_after_start(lease_ttl, clock.now()).await?;
        if extended > 0 {
            tracing::info!(leases = extended, "leases from before the start have one more term");
        }
        let listener = TcpListener::bind(listen)
            .await
            .map_err(|source| ServiceError::Listen { address: listen, source })?;
        let address =
            listener.local_addr().map_err(|source| ServiceError::Listen { address: listen, source })?;
        let stopping = CancellationToken::new();
        let (conductor, jobs) = mpsc::unbounded_channel();
        let app = App {
            store: store.clone(),
            clock: clock.clone(),
            lease_ttl,
            bundle_roots: roots,
            checks: Arc::new(Semaphore::new(limits.checks_at_once.max(1))),
            limits: Arc::new(limits),
            metrics: Arc::new(Metrics::default()),
            stopping: stopping.clone(),
            conductor,
            in_flight: InFlight::default(),
            answers: Arc::default(),
            started: clock.now(),
            openapi: openapi_yaml().into(),
        };
        let tasks = vec![
            tokio::spawn(conduct_for_good(app.clone(), jobs)),
            tokio::spawn(sweep_for_good(app.clone(), clock)),
            tokio::spawn(serve(listener, router(app), stopping.clone())),
        ];
        Ok(Self { address, store, stopping, tasks })
    }

    /// The address that it listens on.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// Its memory, for making tokens in the same process.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Takes no more requests, ends waits and event streams, answers what is being answered, and closes the database.
    pub async fn shutdown(mut self) {
        self.stopping.cancel();
        for mut task in self.tasks.drain(..) {
            if tokio::time::timeout(LAST_ANSWERS, &mut task).await.is_err() {
                tracing::warn!("a request took too long to be waited for");
                task.abort();
            }
        }
        self.store.close().await;
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.stopping.cancel();
        for task in &self.tasks {
            task.abort();
        }
    }
}

/// How long after a panic a loop begins again.
const AFTER_PANIC: Duration = Duration::from_secs(1);

/// A loop that ends by a panic, which is a defect, begins again: without it the service would take requests and do nothing about them.
async fn again_after_panic(name: &str, run: impl Future<Output = ()>) -> bool {
    match AssertUnwindSafe(run).catch_unwind().await {
        Ok(()) => false,
        Err(_) => {
            tracing::error!("{name} panicked; it begins again");
            tokio::time::sleep(AFTER_PANIC).await;
            true
        }
    }
}

async fn conduct_for_good(app: App, mut jobs: mpsc::UnboundedReceiver<JobId>) {
    while again_after_panic("advancing jobs", conduct(&app, &mut jobs)).await {}
}

async fn sweep_for_good(app: App, clock: Arc<SteadyClock>) {
    while again_after_panic("the sweep", sweep(&app, &clock)).await {}
}

/// The least time between two plans that nobody waits for; after one that took long, four times as long as that.
const BREATH: Duration = Duration::from_millis(500);

/// Advances jobs as they are announced, and all that wait once in a while: an advance may have failed for a reason that
/// has passed. Plans the farm anew when something happened, one plan at a time: what happens meanwhile, or soon after, is in the next.
async fn conduct(app: &App, jobs: &mut mpsc::UnboundedReceiver<JobId>) {
    let conductor = Conductor::new(app.store.clone(), app.clock.clone(), app.metrics.clone());
    let mut again = tokio::time::interval(app.lease_ttl.max(Duration::from_secs(1)));
    let mut wanted = app.store.watch_plans();
    let mut not_before = Instant::now();
    // What was due when the service died is due now.
    let mut due = true;
    loop {
        tokio::select! {
            () = app.stopping.cancelled() => return,
            announced = jobs.recv() => match announced {
                Some(job) => conductor.advance(job).await,
                None => return,
            },
            changed = wanted.changed(), if !due => match changed {
                Ok(()) => due = true,
                Err(_) => return,
            },
            () = tokio::time::sleep_until(not_before), if due => {
                wanted.borrow_and_update();
                let begun = Instant::now();
                conductor.replan_if_due().await;
                due = false;
                not_before = Instant::now() + BREATH.max(begun.elapsed() * 4);
            },
            _ = again.tick() => {
                conductor.advance_all().await;
                conductor.watch().await;
                due = true;
            }
        }
    }
}

/// A clock that is this much off was set; less is what a time server corrects all day.
const CLOCK_WAS_SET: Duration = Duration::from_secs(1);

/// Takes back tasks whose leases have run out, four times a lease; before that, follows a clock that was set.
async fn sweep(app: &App, clock: &SteadyClock) {
    let mut ticks = tokio::time::interval((app.lease_ttl / 4).max(Duration::from_millis(100)));
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut lacks_room = false;
    loop {
        tokio::select! {
            () = app.stopping.cancelled() => return,
            _ = ticks.tick() => {}
        }
        lacks_room = app.log_room(lacks_room);
        if let Err(error) = follow(&app.store, clock).await {
            tracing::warn!(%error, "the clock was set and could not be followed; the next sweep tries again");
        }
        match app.store.sweep(app.now()).await {
            Ok(swept) if swept.expired > 0 => {
                app.metrics.leases_expired.add(u64::from(swept.expired));
                tracing::info!(leases = swept.expired, "leases ran out; their tasks are ready again");
            }
            Ok(_) => {}
            Err(error) => tracing::warn!(%error, "the sweep failed; the next one tries again"),
        }
        match app.store.enforce_budgets(app.now()).await {
            Ok(0) => {}
            Ok(changed) => {
                tracing::info!(budgets = changed, "actions of budgets came into force or are over")
            }
            Err(error) => {
                tracing::warn!(%error, "budgets could not be looked at; the next sweep tries again")
            }
        }
    }
}

/// Has the service's time follow the system's, if that was set, and takes everything along that is to end some time after now. The order
/// is such that in between nothing can seem to have run out.
async fn follow(store: &Store, clock: &SteadyClock) -> Result<(), StoreError> {
    let micros = clock.set_by();
    if micros.unsigned_abs() < CLOCK_WAS_SET.as_micros() as u64 {
        clock.follow(micros);
        return Ok(());
    }
    tracing::warn!(
        seconds = micros as f64 * 1e-6,
        "the system's clock was set; leases go on as long as they would have"
    );
    if micros < 0 {
        clock.follow(micros);
    }
    let moved = store.clock_was_set(micros).await;
    match (micros < 0, &moved) {
        (false, Ok(())) => clock.follow(micros),
        // Not moved: as if it had not been noticed.
        (true, Err(_)) => clock.follow(-micros),
        _ => {}
    }
    moved
}
