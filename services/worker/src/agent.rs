//! A worker: leases a task, executes it, reports the result, and repeats.
//!
//! # Failures
//!
//! * **The lease is lost.** It expired while this process was paused or cut off, or the job was cancelled.
//!   The next renewal says so, and the work is stopped. A result that is already on its way has a stale
//!   fencing token: the service refuses it, and the refusal is not an error here.
//! * **The service does not answer.** The work continues, and renewals are retried at each interval. If the
//!   lease expires meanwhile, the fencing token protects its next holder. A finished result is sent until it
//!   is answered.
//! * **The work fails or panics.** The error is reported with the log. The service decides whether to retry.
//! * **The work exceeds a limit.** It is stopped, and the limit is reported as the error.
//! * **The operator intervenes.** Renewals bring orders: to pause, to resume, to drop the task.
//! * **The node should sleep.** The service knows the node's calendar. A renewal, or the answer to a claim,
//!   says until when the node sleeps. Until then this worker only asks once a minute whether that still holds.
//!   It follows the wall clock, so the machine may be suspended.
//! * **Worker and service speak other versions.** A worker that is too old ends, and says which version to
//!   install. One that is too new waits until the service is upgraded.
//! * **This process is told to stop.** The work is stopped and the lease given back, for another node.

mod inputs;

use crate::bundles::Bundles;
use crate::errors::{describe, is_lost, is_unwanted, panic_text};
use crate::limits::gone_beyond;
use forelight_client::{Backoff, Claimed, Client, ClientError};
use forelight_protocol::{
    ClaimRequest, Lease, LeaseOrder, LogLevel, NodeId, NodeRegistration, ProblemKind, RenewRequest, Renewal,
    TaskId, TaskLimits, Timestamp,
};
use forelight_renderer::{Control, Execute, ExecuteError, Outcome, resident_bytes};
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

/// How long a claim waits for a task at the service.
const CLAIM_WAIT_MS: u32 = 20_000;
/// Pause after an unexpected refusal, to limit the rate of requests.
const AFTER_REFUSAL: Duration = Duration::from_secs(2);

/// How often a worker that is too new for the service asks again.
const AFTER_TOO_NEW: Duration = Duration::from_secs(30);

/// How often a sleeping worker checks the clock.
const GLANCE: Duration = Duration::from_secs(30);

/// How often a sleeping worker asks whether it is to sleep on: its calendar may have changed, or its node may
/// be gone.
const ASK_AGAIN: Duration = Duration::from_secs(60);

/// How often checkpoints are sent to the service.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(60);

/// A worker.
pub struct Agent {
    pub(crate) client: Client,
    bundles: Arc<Bundles>,
    executor: Arc<dyn Execute>,
    pool: Arc<rayon::ThreadPool>,
    registration: NodeRegistration,
    /// Distinguishes this process from others that register under the same name.
    worker: Uuid,
    limits: TaskLimits,
    checkpoints: Duration,
    /// Until when this worker sleeps, by this machine's clock.
    asleep: Mutex<Option<(Timestamp, Instant)>>,
    /// Whether the log says that this worker is asleep.
    said_asleep: AtomicBool,
}

/// Why a worker ended by itself.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// The service refused the token or the registration.
    #[error(
        "the service at {address} refused this worker; where the token is not known, the node was removed, or the token expired or is wrong"
    )]
    Refused {
        /// Address of the service.
        address: String,
        /// Its reason.
        source: ClientError,
    },
    /// The service does not understand this program's version. Its reason says what to do.
    #[error("the service at {address} and this worker do not understand each other")]
    Version {
        /// Address of the service.
        address: String,
        /// Its reason.
        source: ClientError,
    },
    /// The threads could not be started.
    #[error("cannot start {threads} threads: {reason}")]
    Threads {
        /// Threads wanted.
        threads: u32,
        /// Error of the operating system.
        reason: String,
    },
}

/// How a process ended that was started for one task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Errand {
    /// It executed the task, and the service knows the outcome: a result or an error.
    Ended,
    /// It lost the lease, or the service refused the outcome. What it did is dropped.
    Dropped,
    /// The task was over before this process could lease it, or this node cannot do it: says which.
    Needless(String),
    /// It was told to stop. If it held the task, it gave the lease back.
    Stopped,
}

/// How the work on a lease ended.
enum Ending {
    /// With a result or an error to report.
    Finished(Box<Result<Outcome, ExecuteError>>),
    /// The lease was lost.
    Lost,
    /// This process must stop.
    Stopped,
    /// The task exceeded a limit and must be stopped first.
    Beyond(ExecuteError),
}

impl Agent {
    /// A worker with this registration, and as many threads as it has cores.
    pub fn new(
        client: Client,
        bundles: Arc<Bundles>,
        executor: Arc<dyn Execute>,
        registration: NodeRegistration,
    ) -> Result<Self, AgentError> {
        let threads = registration.cores;
        let name = registration.name.clone();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads as usize)
            .thread_name(move |index| format!("{name}-{index}"))
            .build()
            .map_err(|error| AgentError::Threads { threads, reason: error.to_string() })?;
        let (pool, limits, checkpoints) = (Arc::new(pool), TaskLimits::default(), CHECKPOINT_INTERVAL);
        let asleep = Mutex::new(None);
        let worker = Uuid::now_v7();
        let said_asleep = AtomicBool::new(false);
        Ok(Self {
            client,
            bundles,
            executor,
            pool,
            registration,
            worker,
            limits,
            checkpoints,
            asleep,
            said_asleep,
        })
    }

    /// Sets limits for every task. If a job has limits too, the stricter ones hold.
    pub fn with_limits(self, limits: TaskLimits) -> Self {
        Self { limits, ..self }
    }

    /// Sets how often checkpoints are sent to the service. Default: once a minute.
    pub fn with_checkpoints(self, interval: Duration) -> Self {
        Self { checkpoints: interval, ..self }
    }

    /// Works until `stop` is cancelled or the service refuses this worker.
    pub async fn run(&self, stop: CancellationToken) -> Result<(), AgentError> {
        let Some(mut node) = self.register(Some(self.worker), &stop).await? else { return Ok(()) };
        let patient = self.client.with_backoff(Backoff::FOREVER);
        let mut was_refused = false;
        while !stop.is_cancelled() {
            self.sleep(&stop).await;
            let claim = ClaimRequest {
                node_id: node,
                wait_ms: CLAIM_WAIT_MS,
                task_id: None,
                worker: Some(self.worker),
            };
            let claimed = tokio::select! {
                () = stop.cancelled() => break,
                claimed = patient.claim(&claim, Uuid::now_v7()) => claimed,
            };
            if claimed.is_ok() {
                was_refused = false;
            }
            match claimed {
                Ok(Claimed::Lease(lease)) => {
                    self.say_awake();
                    self.work(*lease, &stop).await;
                }
                Ok(Claimed::Nothing) => self.say_awake(),
                Ok(Claimed::Asleep(time)) => {
                    self.go_to_sleep(i64::try_from(time.as_micros()).unwrap_or(i64::MAX))
                }
                Err(error) if error.is(ProblemKind::WorkerTooOld) => return Err(self.refused(error)),
                // Its token may have been rotated just now. Then the new one is about to be in the token's
                // file.
                Err(error) if error.is(ProblemKind::Unauthenticated) && !was_refused => {
                    was_refused = true;
                    pause(AFTER_REFUSAL, &stop).await;
                }
                // The worker is refused, or another process has taken its node over.
                Err(error) if is_unwanted(&error) || error.is(ProblemKind::Conflict) => {
                    return Err(self.refused(error));
                }
                // The service lost its data and does not know the node, or it was replaced by an older one.
                Err(error) if error.is(ProblemKind::NotFound) || error.is(ProblemKind::WorkerTooNew) => {
                    match self.register(Some(self.worker), &stop).await? {
                        Some(again) => node = again,
                        None => break,
                    }
                }
                Err(error) => {
                    tracing::warn!(node = self.registration.name, %error, "the service refused the claim");
                    pause(AFTER_REFUSAL, &stop).await;
                }
            }
        }
        Ok(())
    }

    /// Executes one task and ends. Waits while another worker holds the task, so a second process is harmless
    /// and takes over when the first one dies. The outcome is reported to the service, and is no error here.
    pub async fn run_task(&self, task: TaskId, stop: CancellationToken) -> Result<Errand, AgentError> {
        let Some(node) = self.register(None, &stop).await? else { return Ok(Errand::Stopped) };
        let patient = self.client.with_backoff(Backoff::FOREVER);
        while !stop.is_cancelled() {
            let claim =
                ClaimRequest { node_id: node, wait_ms: CLAIM_WAIT_MS, task_id: Some(task), worker: None };
            let claimed = tokio::select! {
                () = stop.cancelled() => break,
                claimed = patient.claim(&claim, Uuid::now_v7()) => claimed,
            };
            match claimed {
                Ok(Claimed::Lease(lease)) => {
                    return Ok(self.work(*lease, &stop).await);
                }
                // A task that was placed on this node runs whatever its calendar says.
                Ok(Claimed::Nothing | Claimed::Asleep(_)) => tracing::info!(%task, "task already leased"),
                Err(error) if error.is(ProblemKind::Conflict) => {
                    let reason = error.problem().map_or_else(|| error.to_string(), |why| why.detail.clone());
                    return Ok(Errand::Needless(reason));
                }
                Err(error) => return Err(self.refused(error)),
            }
        }
        Ok(Errand::Stopped)
    }

    /// Registers the node. Retries until the service answers, and understands this worker. `None` if `stop`
    /// came first.
    async fn register(
        &self,
        worker: Option<Uuid>,
        stop: &CancellationToken,
    ) -> Result<Option<NodeId>, AgentError> {
        let client = self.client.with_backoff(Backoff::FOREVER);
        let registration = NodeRegistration { worker, ..self.registration.clone() };
        let node = loop {
            // Registering is an update by name, so each attempt is a request of its own.
            let registered = tokio::select! {
                () = stop.cancelled() => return Ok(None),
                registered = client.register(&registration, Uuid::now_v7()) => registered,
            };
            match registered {
                Ok(node) => break node,
                // A process for one task does not keep its place waiting.
                Err(error) if error.is(ProblemKind::WorkerTooNew) && worker.is_some() => {
                    tracing::warn!(node = self.registration.name, %error, "waiting for a newer service");
                    pause(AFTER_TOO_NEW, stop).await;
                }
                Err(error) => return Err(self.refused(error)),
            }
        };
        tracing::info!(node = node.name, id = %node.id, speed = node.speed, cores = node.cores, "registered");
        Ok(Some(node.id))
    }

    /// Sets this worker to sleep for this many microseconds.
    fn go_to_sleep(&self, micros: i64) {
        let micros = micros.max(0);
        let until = Timestamp::now().plus_micros(micros);
        *self.asleep.lock() = Some((until, Instant::now() + Duration::from_micros(micros.unsigned_abs())));
    }

    /// Follows the sleep order of a renewal. Its times are by the service's clock.
    fn heed(&self, renewed: &Renewal, lease: &Lease) {
        let ttl = if renewed.order == LeaseOrder::Stop { 0 } else { lease.ttl_ms };
        let there =
            renewed.expires_at.plus_micros(-i64::try_from(ttl).unwrap_or(i64::MAX).saturating_mul(1000));
        match renewed.sleep_until {
            Some(until) => self.go_to_sleep(until.micros_since(there)),
            None => *self.asleep.lock() = None,
        }
    }

    /// Sleeps if ordered, until it is time to ask again. Looks at both clocks regularly: timers stop while
    /// the machine is suspended, and the system's clock may be set back.
    async fn sleep(&self, stop: &CancellationToken) {
        let until = self.asleep.lock().take();
        let Some((until, by_timer)) = until else { return };
        if !self.said_asleep.swap(true, Ordering::Relaxed) {
            tracing::info!(node = self.registration.name, %until, "asleep by its calendar");
        }
        let asks = Instant::now() + ASK_AGAIN;
        while !stop.is_cancelled() {
            let left = until.micros_since(Timestamp::now()).max(0);
            let left = Duration::from_micros(left.unsigned_abs())
                .min(by_timer.min(asks).saturating_duration_since(Instant::now()));
            if left.is_zero() {
                return;
            }
            pause(left.min(GLANCE), stop).await;
        }
    }

    fn say_awake(&self) {
        if self.said_asleep.swap(false, Ordering::Relaxed) {
            tracing::info!(node = self.registration.name, "awake");
        }
    }

    fn refused(&self, source: ClientError) -> AgentError {
        let address = self.client.address().into();
        let is_version = source.is(ProblemKind::WorkerTooOld) || source.is(ProblemKind::WorkerTooNew);
        if is_version {
            AgentError::Version { address, source }
        } else {
            AgentError::Refused { address, source }
        }
    }

    /// Executes one leased task.
    async fn work(&self, lease: Lease, stop: &CancellationToken) -> Errand {
        let kind = lease.spec.kind();
        tracing::info!(task = %lease.task_id, %kind, frame = lease.spec.frame(), fence = lease.fence, "leased");
        let control = Arc::new(Control::with_checkpoints(self.checkpoints));
        let name = &self.registration.name;
        control.log(LogLevel::Info, format!("{kind} started on {name}, attempt {}", lease.fence));
        let limits = lease.limits.and(self.limits);
        let before = resident_bytes();
        let ending = {
            let given_up = CancellationToken::new();
            let work = self.perform(&lease, control.clone(), &given_up);
            tokio::pin!(work);
            let ending = tokio::select! {
                done = &mut work => Ending::Finished(Box::new(done)),
                error = gone_beyond(limits, before, &control) => Ending::Beyond(error),
                () = self.hold(&lease, &control) => Ending::Lost,
                () = stop.cancelled() => Ending::Stopped,
            };
            if !matches!(ending, Ending::Finished(_)) {
                control.cancel();
                given_up.cancel();
                // Wait until the threads are free. Hold the lease if possible, to report the error.
                tokio::select! {
                    _ = &mut work => {}
                    () = self.hold(&lease, &control), if !matches!(ending, Ending::Lost) => {
                        let _ = work.await;
                    }
                }
            }
            match ending {
                Ending::Beyond(error) => Ending::Finished(Box::new(Err(error))),
                other => other,
            }
        };
        match ending {
            Ending::Finished(done) => {
                tokio::select! {
                    ended = self.report(&lease, *done, &control) => return ended,
                    () = self.hold(&lease, &control) => {
                        tracing::info!(task = %lease.task_id, "the lease was lost; the result is dropped");
                        return Errand::Dropped;
                    }
                    () = stop.cancelled() => {}
                }
            }
            Ending::Lost | Ending::Beyond(_) => {
                tracing::info!(task = %lease.task_id, %kind, "the lease was lost; the work is dropped");
                return Errand::Dropped;
            }
            Ending::Stopped => {}
        }
        self.give_back(&lease).await;
        Errand::Stopped
    }

    /// Fetches the inputs of the task, unless it is cancelled, and executes it on this worker's threads.
    async fn perform(
        &self,
        lease: &Lease,
        control: Arc<Control>,
        given_up: &CancellationToken,
    ) -> Result<Outcome, ExecuteError> {
        let assignment = tokio::select! {
            assignment = self.prepare(lease, &control) => assignment?,
            () = given_up.cancelled() => return Err(ExecuteError::Cancelled),
        };
        let (pool, executor) = (self.pool.clone(), self.executor.clone());
        let work = move || pool.install(|| executor.execute(&assignment, &control));
        match tokio::task::spawn_blocking(work).await {
            Ok(done) => done,
            Err(panic) => Err(ExecuteError::Transient(format!("the renderer failed: {}", panic_text(panic)))),
        }
    }

    /// Renews the lease three times per lifetime and passes orders on. Returns when the lease is lost.
    async fn hold(&self, lease: &Lease, control: &Control) {
        let interval = Duration::from_millis((lease.ttl_ms / 3).max(50));
        let once = self.client.with_backoff(Backoff { attempts: Some(1), ..Backoff::PATIENT });
        let mut order = LeaseOrder::Continue;
        let mut unwanted_since = None;
        loop {
            tokio::time::sleep(interval).await;
            if let Some(tiles) = control.take_checkpoint() {
                // Renewals come first: an upload that takes too long is given up.
                let sent = once.put_checkpoint(lease.lease_id, lease.fence, tiles);
                match tokio::time::timeout(interval / 2, sent).await {
                    Ok(Ok(())) => {}
                    Ok(Err(error)) => {
                        tracing::warn!(task = %lease.task_id, %error, "the service did not accept the checkpoint")
                    }
                    Err(_) => {
                        tracing::warn!(task = %lease.task_id, "checkpoint upload too slow; dropped")
                    }
                }
            }
            let renewal = RenewRequest {
                fence: lease.fence,
                progress: control.progress(),
                pixels: control.pixels(),
                paused: control.stands_still(),
                log: control.unsent(),
            };
            match once.renew(lease.lease_id, &renewal, interval.max(Duration::from_secs(1))).await {
                Ok(renewed) if renewed.order == LeaseOrder::Stop => {
                    self.heed(&renewed, lease);
                    return;
                }
                Ok(renewed) => {
                    unwanted_since = None;
                    self.heed(&renewed, lease);
                    control.sent(&renewal.log);
                    renewed.divide_rest.into_iter().for_each(|parts| control.divide_rest(parts));
                    if renewed.order != order {
                        order = renewed.order;
                        let paused = order == LeaseOrder::Pause;
                        control.log(
                            LogLevel::Info,
                            if paused { "paused by the operator" } else { "resumed by the operator" },
                        );
                        control.pause(paused);
                    }
                }
                Err(error) if is_lost(&error) => return,
                Err(error) => {
                    // The token was revoked, and no other came in time. The lease has run out.
                    let lifetime = Duration::from_millis(lease.ttl_ms);
                    let since = *unwanted_since.get_or_insert_with(Instant::now);
                    if !is_unwanted(&error) {
                        unwanted_since = None;
                    } else if since.elapsed() > 2 * lifetime {
                        return;
                    }
                    tracing::warn!(task = %lease.task_id, %error, "the lease was not renewed");
                    control.log(LogLevel::Warn, format!("the lease was not renewed: {}", describe(&error)));
                }
            }
        }
    }
}

async fn pause(time: Duration, stop: &CancellationToken) {
    tokio::select! {
        () = stop.cancelled() => {}
        () = tokio::time::sleep(time) => {}
    }
}
