//! Records failed tasks. [`crate::policy::retries`] decides what follows, [`crate::policy::faults`] whose
//! fault it is.

use forelight_protocol::{
    ArtifactHash, BundleSource, Event, EventKind, JobState, LeaseId, NodeId, TaskError, TaskId, TaskSpec,
    Timestamp,
};

use crate::columns::{Json, Time};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{append, node_event};
use crate::jobs;
use crate::jobs::ending::fail_task_and_job;
use crate::leases::state::LeaseState;
use crate::leases::{LeaseRow, back_to_ready, end, read_in, touch};
use crate::nodes::{self, LOST};
use crate::plans::replans;
use crate::policy::faults::{Fault, Faults, HELD_AGAINST, after_a_look, kind, reason_to_set_aside};
use crate::policy::retries::{HEAD_START, Tried, Witness, job_error, wait};
use crate::writing::run;

/// How an attempt failed.
pub(crate) struct Report<'a> {
    pub error: &'a TaskError,
    /// What is held against its node at once.
    pub fault: Option<Fault>,
}

impl Store {
    /// Records that a worker could not do its task. Returns whether it is a repetition, and the job's state.
    pub async fn fail_task(
        &self,
        lease: LeaseId,
        fence: u64,
        error: &TaskError,
        now: Timestamp,
    ) -> Result<(bool, JobState)> {
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        if row.fence == fence && row.state == LeaseState::Failed {
            return Ok((true, jobs::state(write.connection().await?, row.job_id).await?));
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        touch(&mut write, row.node_id, now);
        fail(&mut write, &row, &Report { error, fault: None }, now).await?;
        let state = jobs::state(write.connection().await?, row.job_id).await?;
        self.commit(write).await?;
        Ok((false, state))
    }

    /// The worker's error, after a look whether the task's input is still there: its bundle, and the
    /// artefacts that it takes over. So neither a node nor a task is blamed for a file that is gone.
    pub async fn after_a_look(&self, lease: LeaseId, error: TaskError, now: Timestamp) -> Result<TaskError> {
        let spec = self.lease(lease).await?.spec;
        let missing = match spec.pictures() {
            [] => self.missing_input(&spec, now).await?,
            // Thousands of files are not read again. Whether they are known is one query.
            pictures => self.missing_picture(pictures).await?,
        };
        Ok(after_a_look(error, missing))
    }

    /// What is gone of a task's input; `None` if nothing is, as far as can be seen.
    async fn missing_input(&self, spec: &TaskSpec, now: Timestamp) -> Result<Option<String>> {
        let mut artifacts = spec.caches();
        match spec.bundle() {
            // What cannot be looked at may be there.
            Some(BundleSource::Path(path)) if !tokio::fs::try_exists(path).await.unwrap_or(true) => {
                return Ok(Some(format!("bundle {path}")));
            }
            Some(BundleSource::Path(_)) | None => {}
            Some(BundleSource::Artifact(hash)) => artifacts.push(*hash),
        }
        artifacts.extend(spec.samples());
        match spec {
            // Pixels of profiles and parts that cannot be read are rendered again.
            TaskSpec::Render(render) => artifacts.extend(render.shares.iter().map(|share| share.hash)),
            spec => artifacts.extend(spec.parts()),
        }
        for hash in artifacts {
            match self.artifacts().get(hash, now).await {
                Err(error @ (StoreError::ArtifactLost { .. } | StoreError::ArtifactDamaged { .. })) => {
                    return Ok(Some(error.to_string()));
                }
                Err(StoreError::NotFound(_)) => return Ok(Some(format!("artefact {hash}"))),
                // While the place of artefacts is away, nothing can be said.
                Ok(_) | Err(_) => {}
            }
        }
        Ok(None)
    }

    /// The first picture that the farm does not have, or that is known to be damaged.
    async fn missing_picture(&self, pictures: &[ArtifactHash]) -> Result<Option<String>> {
        let hashes = Json(pictures.iter().map(ToString::to_string).collect::<Vec<_>>());
        let missing = sqlx::query_scalar!(
            r#"SELECT p.value || '' AS "hash!: String" FROM json_each(?) p LEFT JOIN artifacts a ON a.hash = unhex(p.value)
               WHERE a.hash IS NULL OR a.hash IN (SELECT hash FROM damaged_artifacts) LIMIT 1"#,
            hashes
        );
        let missing = missing.fetch_optional(self.readers()).await?;
        Ok(missing.map(|hash| format!("artefact {hash}, a picture of the video")))
    }

    /// When the next task that waits after a failure may be handed out, to a node on which it failed or to
    /// another. `None` if none waits.
    pub async fn next_retry(&self, now: Timestamp) -> Result<Option<Timestamp>> {
        let at = sqlx::query_scalar!(
            "SELECT min(CASE WHEN not_before > ?1 THEN not_before ELSE not_before + ?2 END) AS \"at?: \
             Time\" FROM tasks INDEXED BY tasks_backing_off WHERE state = 'ready' AND not_before > 0 \
             AND not_before + ?2 > ?1",
            now.micros(),
            HEAD_START
        )
        .fetch_one(self.readers())
        .await?;
        Ok(at.map(Into::into))
    }
}

/// Ends an active lease as failed, inside a write. Its task is tried again, or fails its job.
pub(crate) async fn fail(
    write: &mut Write,
    row: &LeaseRow,
    report: &Report<'_>,
    now: Timestamp,
) -> Result<()> {
    let error = report.error;
    end(write, row, "failed", now);
    let another = could_another(write, row, TriedOn::Failed, now).await?;
    run!(
        write,
        "UPDATE leases SET failure = ?, permanent = ?, fault = ?, alone = ? WHERE id = ?",
        kind(error).name(),
        error.permanent,
        report.fault.map(Fault::name),
        !another,
        row.id.0
    );
    let event = match report.fault {
        Some(Fault::Refused) => EventKind::ResultRefused,
        _ => EventKind::TaskFailed,
    };
    if report.fault == Some(Fault::Refused) {
        // Its pixels must not come back by its checkpoint.
        run!(write, "UPDATE tasks SET begun_anew = fence WHERE id = ?", row.task_id.0);
    }
    append(write, Event { message: Some(error.message.clone()), ..row.event(event, now) });
    let failures = row.failures + 1;
    run!(
        write,
        "UPDATE tasks SET failures = ?, not_before = ? WHERE id = ?",
        failures,
        now.plus_micros(wait(row.task_id, failures)).micros(),
        row.task_id.0
    );
    let witnesses = witnesses(write, row.task_id, now).await?;
    let tried = Tried { task: row.task_id, failures, witnesses: &witnesses, another };
    match job_error(error, &tried) {
        Some(job_error) => fail_task_and_job(write, row, &job_error, now).await?,
        None => back_to_ready(write, row, Some(&error.message)),
    }
    if report.fault.is_some() {
        set_aside_if_at_fault(write, row.node_id, now).await?;
    }
    Ok(())
}

/// After a task succeeded on a node: holds the earlier attempts that failed elsewhere, or whose worker
/// crashed, against their nodes, and all the more if one was called permanent. Only the job is blamed for its
/// limits, and nobody for input that was gone.
pub(crate) async fn hold_against_others(write: &mut Write, row: &LeaseRow, now: Timestamp) -> Result<()> {
    let nodes = sqlx::query_scalar!(
        "UPDATE leases SET fault = ? WHERE task_id = ? AND state IN ('failed', 'expired') AND fault IS NULL \
         AND node_id <> ? AND (failure IN ('unknown', 'node') OR permanent) RETURNING node_id",
        Fault::Unshared.name(),
        row.task_id.0,
        row.node_id.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    for node in nodes {
        set_aside_if_at_fault(write, node.into(), now).await?;
    }
    Ok(())
}

/// After a task was done: ends the attempt beside it, if there is one. If that one stalled, it is held
/// against its node.
pub(crate) async fn end_attempt_beside(write: &mut Write, row: &LeaseRow, now: Timestamp) -> Result<()> {
    let nodes = sqlx::query!(
        "UPDATE leases SET state = 'revoked', ended_at = coalesce(paid_until, min(?, expires_at)), \
         fault = CASE lateness WHEN 'stalled' THEN ? END WHERE task_id = ? AND state = 'active' \
         AND id <> ? RETURNING node_id, fault AS \"fault?\"",
        now.micros(),
        Fault::Stalled.name(),
        row.task_id.0,
        row.id.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    for beside in nodes {
        if beside.fault.is_some() {
            set_aside_if_at_fault(write, beside.node_id.into(), now).await?;
        }
    }
    Ok(())
}

/// The nodes on which a task failed, by name.
async fn witnesses(write: &mut Write, task: TaskId, now: Timestamp) -> Result<Vec<Witness>> {
    Ok(sqlx::query_as!(
        Witness,
        "SELECT n.name AS \"name!\", max(l.permanent) AS \"permanent!: bool\", \
         EXISTS (SELECT 1 FROM leases f INDEXED BY leases_at_fault WHERE f.node_id = n.id AND f.fault IS NOT NULL \
                 AND f.ended_at > max(?2, n.trusted_since)) AS \"doubted!: bool\" \
         FROM leases l JOIN nodes n ON n.id = l.node_id \
         WHERE l.task_id = ?1 AND l.state = 'failed' GROUP BY n.id ORDER BY n.name",
        task.0,
        now.plus_micros(-HELD_AGAINST).micros()
    )
    .fetch_all(write.connection().await?)
    .await?)
}

/// Which nodes have tried a task in vain.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum TriedOn {
    Failed,
    FailedOrLost,
}

/// Whether another node could do a task: it takes tasks, was heard of lately, has its renderer, and has not
/// tried it in vain.
pub(crate) async fn could_another(
    write: &mut Write,
    row: &LeaseRow,
    tried: TriedOn,
    now: Timestamp,
) -> Result<bool> {
    Ok(sqlx::query_scalar!(
        "SELECT EXISTS (SELECT 1 FROM nodes n WHERE n.id <> ?1 AND n.set_aside IS NULL AND NOT n.drain \
         AND NOT n.pause AND n.last_seen_at >= ?2 \
         AND (?3 IS NULL OR ?3 IN (SELECT value FROM json_each(n.renderers))) \
         AND NOT EXISTS (SELECT 1 FROM leases f WHERE f.task_id = ?4 AND f.node_id = n.id \
                         AND (f.state = 'failed' OR ?5 AND f.state = 'expired'))) AS \"another!: bool\"",
        row.node_id.0,
        now.plus_micros(-LOST).micros(),
        row.renderer,
        row.task_id.0,
        tried == TriedOn::FailedOrLost
    )
    .fetch_one(write.connection().await?)
    .await?)
}

/// Sets a node aside that is at fault for too many tasks.
async fn set_aside_if_at_fault(write: &mut Write, node: NodeId, now: Timestamp) -> Result<()> {
    let faults = sqlx::query_as!(
        Faults,
        "SELECT count(DISTINCT CASE l.fault WHEN 'stalled' THEN l.task_id END) AS \"stalled!: i64\", \
         count(DISTINCT l.task_id) AS \"all!: i64\", \
         (SELECT m.fault FROM leases m INDEXED BY leases_at_fault WHERE m.node_id = ?1 AND m.fault IS NOT NULL \
          ORDER BY m.ended_at DESC, m.id DESC LIMIT 1) AS \"last?: String\" \
         FROM leases l INDEXED BY leases_at_fault WHERE l.node_id = ?1 AND l.fault IS NOT NULL \
         AND l.ended_at > max(?2, (SELECT trusted_since FROM nodes WHERE id = ?1))",
        node.0,
        now.plus_micros(-HELD_AGAINST).micros()
    )
    .fetch_one(write.connection().await?)
    .await?;
    let Some(reason) = reason_to_set_aside(&faults) else { return Ok(()) };
    let set =
        run!(write, "UPDATE nodes SET set_aside = ? WHERE id = ? AND set_aside IS NULL", reason, node.0);
    if set == 1 {
        let node = nodes::read(write.connection().await?, node).await?;
        replans::want(write, &format!("node {} is set aside", node.name)).await?;
        node_event(write, EventKind::NodeSetAside, &node, format!("{}: {reason}", node.name), now);
    }
    Ok(())
}
