//! A worker: leases a task, does it, reports, and starts over.
//!
//! # What can go wrong, and what happens then
//!
//! * **The lease is lost** (it ran out while this process was paused or cut off, or the job was cancelled). The next
//!   renewal says so; the work is stopped at once and dropped. Should the result already be on its way, its fencing token is
//!   stale: the service refuses it, nothing is overwritten, and the refusal is not an error here.
//! * **The service is silent.** It may be restarting. The work goes on and renewals are tried at each interval: if the lease
//!   is still ours when the service is back, nothing was lost; if it is not, the fencing token protects whoever has it
//!   now. A finished result is offered until it is answered.
//! * **The work fails or panics.** The error is reported with what there was to say, and the service decides whether to try again.
//! * **The work goes beyond a limit.** It is stopped, and the limit reported as the error.
//! * **The operator has other plans.** Renewals bring orders: to stand still, to go on, to drop the task.
//! * **It is time to sleep.** The node's calendar is the service's to know. A renewal, or the answer to a claim, says until when the node
//!   sleeps: until then this worker asks for nothing, by the clock on the wall, so that a machine may be suspended meanwhile.
//! * **This process is told to stop.** The work is stopped and the lease given back, so that another node can have the
//!   task at once instead of after the lease's end.

pub(crate) mod capabilities;
pub(crate) mod checkpoint;
pub(crate) mod execute;
pub(crate) mod library;
pub(crate) mod limits;

mod report;

use crate::agent::execute::{Assignment, Control, Execute, ExecuteError, Outcome};
use crate::agent::library::Library;
use crate::agent::limits::gone_beyond;
use bytes::Bytes;
use forelight_client::{Backoff, Claimed, Client, ClientError};
use forelight_protocol::{
    CACHE_BYTES, ClaimRequest, Lease, LeaseOrder, LogLevel, NodeId, NodeRegistration, ProblemKind,
    RenewRequest, Renewal, TaskId, TaskLimits, TaskSpec, Timestamp,
};
use parking_lot::Mutex;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

/// How long one claim waits for a task at the service.
const CLAIM_WAIT_MS: u32 = 20_000;
/// Pause after a refusal that is nobody's plan, so that it does not become a flood.
const AFTER_REFUSAL: Duration = Duration::from_secs(2);

/// How often a sleeping worker looks at the clock.
const GLANCE: Duration = Duration::from_secs(30);

/// How often what is finished of a frame is sent to the service, so that the next worker goes on from there should this one be lost.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(60);

/// A worker.
pub struct Agent {
    client: Client,
    library: Arc<Library>,
    executor: Arc<dyn Execute>,
    pool: Arc<rayon::ThreadPool>,
    registration: NodeRegistration,
    /// What tells this process from others that may register under the same name.
    worker: Uuid,
    limits: TaskLimits,
    checkpoints: Duration,
    /// Until when the service wants this worker to sleep, by this machine's clock.
    asleep: Mutex<Option<Timestamp>>,
}

/// Why a worker ended without being told to.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// The service does not want it: wrong token, or a registration that it refuses.
    #[error("the service at {address} does not take this worker")]
    Refused {
        /// The service.
        address: String,
        /// Its reason.
        source: ClientError,
    },
    /// The threads could not be started.
    #[error("cannot start {threads} threads: {reason}")]
    Threads {
        /// How many were wanted.
        threads: u32,
        /// What the system said.
        reason: String,
    },
}

/// What became of a process that was started for one task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Errand {
    /// It had the task, and the service knows how that ended.
    Ended,
    /// The task was over before it had it.
    Needless,
    /// It was told to stop; if it had the task, it has given it back.
    Stopped,
}

/// How the work on a lease ended.
enum Ending {
    /// With a result or an error, to be reported.
    Finished(Box<Result<Outcome, ExecuteError>>),
    /// Without: nobody waits for it any more.
    Lost,
    /// Without: this process is to stop.
    Stopped,
    /// With this error: it went beyond a limit, and has to be stopped first.
    Beyond(ExecuteError),
}

impl Agent {
    /// A worker that registers as `registration` says, and works on as many threads as that has cores.
    pub fn new(
        client: Client,
        library: Arc<Library>,
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
        Ok(Self { client, library, executor, pool, registration, worker, limits, checkpoints, asleep })
    }

    /// The same worker with limits of its own for every task; where a job sets its own, the stricter holds.
    pub fn with_limits(self, limits: TaskLimits) -> Self {
        Self { limits, ..self }
    }

    /// The same worker, which sends what is finished of a frame to the service at this interval; a minute, if this is not called.
    pub fn with_checkpoints(self, interval: Duration) -> Self {
        Self { checkpoints: interval, ..self }
    }

    /// Works until `stop` is cancelled, or until the service does not want this worker.
    pub async fn run(&self, stop: CancellationToken) -> Result<(), AgentError> {
        let Some(mut node) = self.register(Some(self.worker), &stop).await? else { return Ok(()) };
        let patient = self.client.with_backoff(Backoff::FOREVER);
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
            match claimed {
                Ok(Claimed::Lease(lease)) => self.work(*lease, &stop).await,
                Ok(Claimed::Nothing) => {}
                Ok(Claimed::Asleep(time)) => {
                    self.go_to_sleep(i64::try_from(time.as_micros()).unwrap_or(i64::MAX))
                }
                // It does not want this worker, or another has taken its node over.
                Err(error) if is_unwanted(&error) || error.is(ProblemKind::Conflict) => {
                    return Err(self.refused(error));
                }
                // A service that lost its memory does not know the node any more.
                Err(error) if error.is(ProblemKind::NotFound) => {
                    match self.register(Some(self.worker), &stop).await? {
                        Some(again) => node = again,
                        None => break,
                    }
                }
                Err(error) => {
                    tracing::warn!(node = self.registration.name, %error, "no task was handed out");
                    pause(AFTER_REFUSAL, &stop).await;
                }
            }
        }
        Ok(())
    }

    /// Does one task, which this process was started for, and ends. It waits while another worker holds the task, as long as that one
    /// renews; so a process that was started twice is harmless, and takes over when the first one dies. What became of it is told to
    /// the service, and is no error here.
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
                    self.work(*lease, &stop).await;
                    return Ok(if stop.is_cancelled() { Errand::Stopped } else { Errand::Ended });
                }
                // Whoever placed the task here has decided that this node does it, whatever its calendar.
                Ok(Claimed::Nothing | Claimed::Asleep(_)) => tracing::info!(%task, "another worker has it"),
                Err(error) if error.is(ProblemKind::Conflict) => return Ok(Errand::Needless),
                Err(error) => return Err(self.refused(error)),
            }
        }
        Ok(Errand::Stopped)
    }

    /// Announces the node until the service answers; `None` if `stop` came first.
    async fn register(
        &self,
        worker: Option<Uuid>,
        stop: &CancellationToken,
    ) -> Result<Option<NodeId>, AgentError> {
        let client = self.client.with_backoff(Backoff::FOREVER);
        let registration = NodeRegistration { worker, ..self.registration.clone() };
        // Registering is an update by name: each time is a request of its own.
        let registered = tokio::select! {
            () = stop.cancelled() => return Ok(None),
            registered = client.register(&registration, Uuid::now_v7()) => registered,
        };
        let node = registered.map_err(|error| self.refused(error))?;
        tracing::info!(node = node.name, id = %node.id, speed = node.speed, cores = node.cores, "registered");
        Ok(Some(node.id))
    }

    /// From now on, and for so many microseconds, this worker is to ask for nothing.
    fn go_to_sleep(&self, micros: i64) {
        let until = Timestamp::now().plus_micros(micros.max(0));
        *self.asleep.lock() = Some(until);
    }

    /// Follows what a renewal says of sleep. Its instants are those of the service's clock, which says when it is by when the lease ends.
    fn heed(&self, renewed: &Renewal, lease: &Lease) {
        let ttl = if renewed.order == LeaseOrder::Stop { 0 } else { lease.ttl_ms };
        let there =
            renewed.expires_at.plus_micros(-i64::try_from(ttl).unwrap_or(i64::MAX).saturating_mul(1000));
        match renewed.sleep_until {
            Some(until) => self.go_to_sleep(until.micros_since(there)),
            None => *self.asleep.lock() = None,
        }
    }

    /// Sleeps if it is to. The clock is looked at once in a while: a timer stands still while the machine is suspended.
    async fn sleep(&self, stop: &CancellationToken) {
        let until = self.asleep.lock().take();
        let Some(until) = until else { return };
        tracing::info!(node = self.registration.name, %until, "asleep by its calendar");
        while !stop.is_cancelled() {
            let left = until.micros_since(Timestamp::now());
            if left <= 0 {
                tracing::info!(node = self.registration.name, "awake");
                return;
            }
            pause(Duration::from_micros(left.unsigned_abs()).min(GLANCE), stop).await;
        }
    }

    fn refused(&self, source: ClientError) -> AgentError {
        AgentError::Refused { address: self.client.address().into(), source }
    }

    /// Does one leased task from beginning to end.
    async fn work(&self, lease: Lease, stop: &CancellationToken) {
        let kind = lease.spec.kind();
        tracing::info!(task = %lease.task_id, %kind, frame = lease.spec.frame(), fence = lease.fence, "leased");
        let control = Arc::new(Control::with_checkpoints(self.checkpoints));
        let name = &self.registration.name;
        control.log(LogLevel::Info, format!("{kind} begun on {name}, attempt {}", lease.fence));
        let limits = lease.limits.and(self.limits);
        let ending = {
            let given_up = CancellationToken::new();
            let work = self.perform(&lease, control.clone(), &given_up);
            tokio::pin!(work);
            let ending = tokio::select! {
                done = &mut work => Ending::Finished(Box::new(done)),
                error = gone_beyond(limits, &control) => Ending::Beyond(error),
                () = self.hold(&lease, &control) => Ending::Lost,
                () = stop.cancelled() => Ending::Stopped,
            };
            if !matches!(ending, Ending::Finished(_)) {
                control.cancel();
                given_up.cancel();
                // The threads are free again when the work has noticed. Until then the lease is held, if it still is: its end is to be told.
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
                    () = self.report(&lease, *done, &control) => {}
                    () = self.hold(&lease, &control) => {
                        tracing::info!(task = %lease.task_id, "the lease was lost; its result is dropped");
                    }
                    () = stop.cancelled() => self.give_back(&lease).await,
                }
            }
            Ending::Lost | Ending::Beyond(_) => {
                tracing::info!(task = %lease.task_id, %kind, "the lease was lost; the work is dropped")
            }
            Ending::Stopped => self.give_back(&lease).await,
        }
    }

    /// Fetches what the task needs, unless it is given up meanwhile, and does it on this worker's threads.
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

    /// Everything that a task needs to be begun.
    async fn prepare(&self, lease: &Lease, control: &Control) -> Result<Assignment, ExecuteError> {
        let failed = |error: ClientError| {
            let message = describe(&error);
            // What the service does not have, it will not have later.
            let missing = error.is(ProblemKind::NotFound);
            if missing { ExecuteError::Permanent(message) } else { ExecuteError::Transient(message) }
        };
        let (bundle, profile, caches) = loop {
            match self.fetch(lease).await {
                Ok(fetched) => break fetched,
                // That the service or its artefact store is away for a while is not the task's fault.
                Err(error) if error.is_passing() => {
                    tracing::warn!(task = %lease.task_id, %error, "what the task needs cannot be fetched yet");
                    tokio::time::sleep(AFTER_REFUSAL).await;
                }
                Err(error) => return Err(failed(error)),
            }
        };
        control.log(LogLevel::Info, "the bundle is here");
        let checkpoint = match &lease.spec {
            // Only another attempt can have left something behind. Without it, the frame is done from the beginning.
            TaskSpec::Render(_) if lease.fence > 1 => {
                self.client.checkpoint(lease.lease_id).await.unwrap_or_default()
            }
            _ => None,
        };
        Ok(Assignment { spec: lease.spec.clone(), bundle, profile, caches, checkpoint })
    }

    /// The bundle, the profile and the irradiance caches that a task needs.
    async fn fetch(&self, lease: &Lease) -> Result<(PathBuf, Option<Bytes>, Vec<Bytes>), ClientError> {
        let bundle = self.library.locate(&self.client, lease.spec.bundle()).await?;
        let profile = match &lease.spec {
            TaskSpec::Render(spec) => spec.profile,
            _ => None,
        };
        let profile = match profile {
            Some(hash) => Some(self.client.artifact(hash, CACHE_BYTES).await?),
            None => None,
        };
        let mut caches = Vec::new();
        for hash in lease.spec.caches() {
            caches.push(self.client.artifact(hash, CACHE_BYTES).await?);
        }
        Ok((bundle, profile, caches))
    }

    /// Renews the lease three times in its life, passes orders on to the work, and returns when the service says that the lease is lost
    /// or not wanted.
    async fn hold(&self, lease: &Lease, control: &Control) {
        let interval = Duration::from_millis((lease.ttl_ms / 3).max(50));
        let once = self.client.with_backoff(Backoff { attempts: Some(1), ..Backoff::PATIENT });
        let mut order = LeaseOrder::Continue;
        loop {
            tokio::time::sleep(interval).await;
            if let Some(tiles) = control.take_checkpoint() {
                // The renewal comes first: what does not get through in a part of the lease's time is given up.
                let sent = once.put_checkpoint(lease.lease_id, lease.fence, tiles);
                match tokio::time::timeout(interval / 2, sent).await {
                    Ok(Ok(())) => {}
                    Ok(Err(error)) => {
                        tracing::warn!(task = %lease.task_id, %error, "finished tiles were not taken")
                    }
                    Err(_) => {
                        tracing::warn!(task = %lease.task_id, "finished tiles take too long to be sent")
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
                    self.heed(&renewed, lease);
                    control.sent(&renewal.log);
                    if renewed.order != order {
                        order = renewed.order;
                        let paused = order == LeaseOrder::Pause;
                        control
                            .log(LogLevel::Info, if paused { "paused by order" } else { "goes on by order" });
                        control.pause(paused);
                    }
                }
                Err(error) if is_lost(&error) => return,
                Err(error) => {
                    tracing::warn!(task = %lease.task_id, %error, "the lease was not renewed");
                    control.log(LogLevel::Warn, format!("the lease was not renewed: {}", describe(&error)));
                }
            }
        }
    }
}

/// Whether the service said that the lease is not ours any more.
fn is_lost(error: &ClientError) -> bool {
    error.is(ProblemKind::LeaseLost) || error.is(ProblemKind::NotFound) || error.is(ProblemKind::Conflict)
}

/// Whether asking again with this token cannot help.
fn is_unwanted(error: &ClientError) -> bool {
    error.is(ProblemKind::Unauthenticated) || error.is(ProblemKind::Forbidden)
}

async fn pause(time: Duration, stop: &CancellationToken) {
    tokio::select! {
        () = stop.cancelled() => {}
        () = tokio::time::sleep(time) => {}
    }
}

/// An error with its causes on one line.
fn describe(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text += &format!(": {error}");
        cause = error.source();
    }
    text
}

fn panic_text(error: tokio::task::JoinError) -> String {
    let Ok(payload) = error.try_into_panic() else { return "it was cancelled".into() };
    let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "it panicked".into())
}
