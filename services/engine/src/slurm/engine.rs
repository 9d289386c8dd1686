//! The loop. Each round compares Slurm's jobs with the store and submits waiting tasks.

use std::collections::BTreeSet;
use std::time::Duration;

use forelight_protocol::Timestamp;
use forelight_store::{OpenArray, SeenNode, Store, StoreError};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::answer::{SlurmJob, SlurmNode, Stage};
use super::arrays::{Batch, Pricing, due};
use super::cluster::{Cluster, ClusterError, Programs};
use super::command::{self, Reservation, Submitting};
use super::next_step::{Step, next_step};

/// An announced array that Slurm has not known for this long was never submitted. One minute, in
/// microseconds; longer than the timeouts of the controller and `sbatch`.
const UNSURE: i64 = 60_000_000;

/// Pause in submitting after a refusal: 30 s, in microseconds.
const AFTER_REFUSAL: i64 = 30_000_000;

/// Tasks often become ready together. This delay puts them into one array.
const GATHER: Duration = Duration::from_millis(300);

/// A node not seen for this long is ignored, as in bookings: five minutes, in microseconds.
const SILENCE: i64 = 300_000_000;

/// Elements leave a reservation that ends sooner than their limit plus this: one minute, in microseconds.
/// Slurm kills jobs that still run when a reservation ends.
const LEAVE_AHEAD: i64 = 60_000_000;

/// Interval between heartbeats of unchanged nodes: 30 s, in microseconds.
const NODES_AGAIN: i64 = 30_000_000;

/// Normal reasons to wait. Any other reason is reported.
const WELL: [&str; 9] = [
    "",
    "None",
    "BeginTime",
    "Priority",
    "Reservation",
    "Resources",
    "JobArrayTaskLimit",
    "Licenses",
    "NodeDown",
];

/// Most elements in one `scancel`.
const CANCELLED_AT_ONCE: usize = 500;

/// Settings of the engine.
#[derive(Clone, Debug)]
pub struct Options {
    /// How arrays are submitted.
    pub submitting: Submitting,
    /// Limit of previews and profiles, in minutes.
    pub quote_minutes: u32,
    /// User of the reservations. `None` for no reservations.
    pub reserve_for: Option<String>,
    /// Pause between rounds.
    pub poll: Duration,
}

/// The engine.
pub struct Engine<C> {
    store: Store,
    cluster: C,
    submitting: Submitting,
    quote_minutes: u32,
    reserve_for: Option<String>,
    poll: Duration,
    /// No submission before this time.
    refused_until: Option<Timestamp>,
    /// Last reported trouble.
    trouble: Option<String>,
    /// Arrays already reported as stuck, with the reason.
    stuck: BTreeSet<(Uuid, String)>,
    /// Nodes last written to the store, and when.
    noted: Option<(Timestamp, Vec<SeenNode>)>,
}

#[derive(Debug, thiserror::Error)]
enum RoundError {
    #[error(transparent)]
    Cluster(#[from] ClusterError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl Engine<Programs> {
    /// An engine that uses Slurm's own programs. Fails if one is missing; the controller may be away.
    pub async fn start(store: Store, options: Options) -> Result<Self, ClusterError> {
        Programs::check().await?;
        Ok(Self::new(store, Programs, options))
    }
}

impl<C: Cluster> Engine<C> {
    /// An engine on the given cluster.
    pub fn new(store: Store, cluster: C, options: Options) -> Self {
        Self {
            store,
            cluster,
            submitting: options.submitting,
            quote_minutes: options.quote_minutes.max(1),
            reserve_for: options.reserve_for,
            poll: options.poll,
            refused_until: None,
            trouble: None,
            stuck: BTreeSet::new(),
            noted: None,
        }
    }

    /// Runs until `stop` is cancelled. Jobs in Slurm continue and are found again at the next start.
    pub async fn run(mut self, stop: CancellationToken) {
        let mut work = self.store.watch_work();
        loop {
            work.borrow_and_update();
            let now = Timestamp::now();
            let outcome = self.round(now).await;
            self.tell(outcome, now).await;
            tokio::select! {
                () = stop.cancelled() => return,
                () = tokio::time::sleep(self.poll) => {}
                changed = work.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    tokio::time::sleep(GATHER.min(self.poll)).await;
                }
            }
        }
    }

    async fn round(&mut self, now: Timestamp) -> Result<(), RoundError> {
        let nodes = self.cluster.nodes(self.submitting.partition.as_deref()).await?;
        self.note_nodes(&nodes, now).await?;
        let jobs = self.cluster.jobs().await?;
        let arrays = self.store.open_slurm_arrays().await?;
        self.stuck.retain(|(array, _)| arrays.iter().any(|open| open.id == *array));
        for array in arrays {
            self.look_after(&array, &jobs, now).await?;
        }
        self.hand_over(&nodes, now).await
    }

    /// Writes Slurm's nodes that are up to the store.
    async fn note_nodes(&mut self, nodes: &[SlurmNode], now: Timestamp) -> Result<(), RoundError> {
        let up = nodes.iter().filter(|node| node.up);
        let there: Vec<SeenNode> =
            up.map(|node| SeenNode { name: node.name.clone(), cores: node.cpus }).collect();
        let known = self.noted.as_ref();
        if known.is_some_and(|(at, known)| *known == there && now.micros_since(*at) < NODES_AGAIN) {
            return Ok(());
        }
        self.store.see_nodes(&there, self.submitting.price_per_hour, now).await?;
        self.noted = Some((now, there));
        Ok(())
    }

    /// Updates an array from Slurm's jobs.
    async fn look_after(
        &mut self,
        array: &OpenArray,
        jobs: &[SlurmJob],
        now: Timestamp,
    ) -> Result<(), RoundError> {
        let mark = command::mark(array.id);
        let slurm_id = match array.slurm_id {
            Some(number) => number,
            None => match jobs.iter().find(|job| job.comment == mark) {
                Some(job) => {
                    tracing::info!(array = %array.id, slurm = job.array, "found an array whose submission was not yet recorded");
                    self.store.slurm_array_submitted(array.id, job.array, now).await?;
                    job.array
                }
                None if now.micros_since(array.announced) < UNSURE => return Ok(()),
                None => {
                    tracing::info!(array = %array.id, "an array never reached Slurm; its tasks wait for the next submission");
                    self.give_up_reservation(array).await?;
                    return Ok(self.store.slurm_array_refused(array.id).await?);
                }
            },
        };
        // A number alone may belong to another job: a controller that lost its state counts from one again.
        let own: Vec<&SlurmJob> =
            jobs.iter().filter(|job| job.array == slurm_id && job.comment == mark).collect();
        for job in
            own.iter().filter(|job| job.stage() == Stage::Pending && !WELL.contains(&job.reason.as_str()))
        {
            if self.stuck.insert((array.id, job.reason.clone())) {
                let message = format!("Slurm keeps job {slurm_id} waiting: {}", job.reason);
                tracing::warn!("{message}");
                self.store.tell_of_engine(&message, now).await?;
            }
        }
        let mut unwanted = Vec::new();
        let mut live = Vec::new();
        for element in &array.elements {
            let seen = own.iter().find(|job| job.is_about(element.position)).copied();
            if seen.is_some_and(|job| matches!(job.stage(), Stage::Pending | Stage::Running)) {
                live.push(element.position);
            }
            match next_step(element.state, seen) {
                Step::Leave => {}
                Step::Cancel => unwanted.push(element.position),
                Step::End(outcome) => {
                    tracing::info!(task = %element.task, slurm = slurm_id, element = element.position, outcome, "ended");
                    self.store.slurm_element_ended(array.id, element.position, &outcome, now).await?;
                }
            }
        }
        for positions in unwanted.chunks(CANCELLED_AT_ONCE) {
            tracing::info!(slurm = slurm_id, elements = ?positions, "cancelled elements whose tasks are done or withdrawn");
            self.cluster.cancel(command::scancel(slurm_id, positions)).await?;
        }
        self.look_after_reservation(array, slurm_id, &live, now).await
    }

    /// Deletes a reservation when its elements are done. Elements that would outlast it leave it before it
    /// ends.
    async fn look_after_reservation(
        &self,
        array: &OpenArray,
        slurm_id: u32,
        live: &[u32],
        now: Timestamp,
    ) -> Result<(), RoundError> {
        let Some((_, until)) = &array.array.reservation else { return Ok(()) };
        let limit = i64::from(array.array.limit_minutes) * 60_000_000;
        if !array.elements.is_empty() && until.micros_since(now) > limit + LEAVE_AHEAD {
            return Ok(());
        }
        if !live.is_empty() {
            let leave = command::leave_reservation(slurm_id, live);
            if taken(self.cluster.control(leave).await)? {
                tracing::info!(
                    slurm = slurm_id,
                    "the array runs late; its remaining elements leave the reservation"
                );
            }
        }
        // Slurm keeps the reservation busy for a moment after its jobs end. A reservation that cannot be
        // deleted expires.
        if self.give_up_reservation(array).await? || *until <= now {
            self.store.slurm_reservation_ended(array.id).await?;
        }
        Ok(())
    }

    /// Returns true if the array has no reservation left in Slurm.
    async fn give_up_reservation(&self, array: &OpenArray) -> Result<bool, RoundError> {
        match &array.array.reservation {
            Some((name, _)) => taken(self.cluster.control(command::give_up(name)).await),
            None => Ok(true),
        }
    }

    async fn hand_over(&mut self, nodes: &[SlurmNode], now: Timestamp) -> Result<(), RoundError> {
        let waiting = self.store.waiting_for_slurm().await?;
        let slowest = self.store.slowest_node(now.plus_micros(-SILENCE)).await?;
        let pricing = Pricing { slowest: slowest.unwrap_or(1.0), quote_minutes: self.quote_minutes };
        let due = due(&waiting, pricing, now);
        for (task, reason) in due.hopeless {
            let reason =
                format!("{reason}; see the logs of its processes in {}", self.submitting.logs.display());
            tracing::error!(task = %task.task, reason, "given up");
            self.store.fail_unrunnable(task.task, &reason, now).await?;
        }
        if self.refused_until.is_some_and(|until| now < until) {
            return Ok(());
        }
        let mut closed = self.store.closed_nodes().await?;
        closed.retain(|name| nodes.iter().any(|node| node.name == *name));
        for batch in due.batches {
            match self.submit(batch, &closed, now).await {
                // A task was taken in the meantime. The next round looks again.
                Err(RoundError::Store(StoreError::Conflict(reason))) => {
                    tracing::debug!(reason, "not submitted")
                }
                Err(error @ RoundError::Cluster(ClusterError::Refused { .. })) => {
                    self.refused_until = Some(now.plus_micros(AFTER_REFUSAL));
                    return Err(error);
                }
                other => other?,
            }
        }
        Ok(())
    }

    async fn submit(&mut self, batch: Batch, closed: &[String], now: Timestamp) -> Result<(), RoundError> {
        let Batch { mut array, kind, job_name, keep_free, avoid } = batch;
        if let Some((nodes, start, end)) = keep_free {
            let end = end.plus_micros(i64::from(array.limit_minutes) * 60_000_000 + LEAVE_AHEAD);
            array.reservation = self.reserve(nodes, start, end, now).await?.map(|name| (name, end));
        }
        let id = self.store.announce_slurm_array(&array, now).await?;
        let closed: Vec<String> = closed.iter().cloned().chain(avoid).collect();
        let arguments = command::sbatch(&self.submitting, id, &array, &job_name, kind, &closed);
        let script = command::script(&self.submitting, &array.tasks);
        match self.cluster.submit(arguments, script).await {
            Ok(number) => {
                tracing::info!(slurm = number, tasks = array.tasks.len(), %kind, job = job_name, "submitted");
                Ok(self.store.slurm_array_submitted(id, number, now).await?)
            }
            Err(error @ (ClusterError::Refused { .. } | ClusterError::Missing { .. })) => {
                self.store.slurm_array_refused(id).await?;
                if let Some((name, _)) = &array.reservation {
                    taken(self.cluster.control(command::give_up(name)).await)?;
                }
                Err(error.into())
            }
            // The submission may have succeeded. The next round looks it up by its comment.
            Err(error @ (ClusterError::Away(_) | ClusterError::Answer(_))) => Err(error.into()),
        }
    }

    /// Reserves nodes if wanted and allowed, and returns the reservation's name.
    async fn reserve(
        &mut self,
        nodes: Vec<String>,
        start: Timestamp,
        end: Timestamp,
        now: Timestamp,
    ) -> Result<Option<String>, RoundError> {
        let Some(user) = self.reserve_for.clone() else { return Ok(None) };
        let name = format!("forelight_{}", &Uuid::new_v4().simple().to_string()[..12]);
        let reservation = Reservation { name, nodes, start, end };
        let partition = self.submitting.partition.as_deref();
        match self.cluster.control(command::reserve(&reservation, &user, partition, now)).await {
            Ok(()) => {
                tracing::info!(name = reservation.name, nodes = ?reservation.nodes, "reserved");
                Ok(Some(reservation.name))
            }
            Err(ClusterError::Refused { reason, .. }) => {
                let lower = reason.to_ascii_lowercase();
                if lower.contains("permission") || lower.contains("privilege") || lower.contains("access") {
                    self.reserve_for = None;
                    let message = format!(
                        "Slurm does not let this user reserve nodes, so jobs run without reservations ({reason})"
                    );
                    self.store.tell_of_engine(&message, now).await?;
                } else {
                    tracing::info!(reason, "Slurm refused the reservation; the array waits in the queue");
                }
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Reports trouble once, and its end once.
    async fn tell(&mut self, outcome: Result<(), RoundError>, now: Timestamp) {
        let (trouble, message) = match outcome {
            Ok(()) if self.trouble.is_none() => return,
            // No submission was tried, so the trouble may go on.
            Ok(()) if self.refused_until.is_some_and(|until| now < until) => return,
            Ok(()) => (None, "Slurm answers again; tasks are submitted".to_owned()),
            Err(RoundError::Store(error)) => {
                tracing::warn!(%error, "the store failed; the next round tries again");
                return;
            }
            Err(RoundError::Cluster(error)) => {
                // An absent controller counts as one trouble, whatever the message says.
                let kind = match &error {
                    ClusterError::Away(_) => "away".to_owned(),
                    other => other.to_string(),
                };
                (Some(kind), format!("{error}; tasks wait"))
            }
        };
        if self.trouble == trouble {
            return;
        }
        match trouble {
            Some(_) => tracing::warn!("{message}"),
            None => tracing::info!("{message}"),
        }
        self.trouble = trouble;
        if let Err(error) = self.store.tell_of_engine(&message, now).await {
            tracing::warn!(%error, "cannot record the event about Slurm");
        }
    }
}

/// True if Slurm did what it was told. A refusal is only logged: nothing depends on it.
fn taken(outcome: Result<(), ClusterError>) -> Result<bool, RoundError> {
    match outcome {
        Ok(()) => Ok(true),
        Err(error @ ClusterError::Refused { .. }) => {
            tracing::debug!(%error, "not changed");
            Ok(false)
        }
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests;
