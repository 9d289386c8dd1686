//! Holds what a worker says against what is possible. [`crate::policy::evidence`] has the bounds.
//!
//! A result that is not possible ends its lease: the task is done elsewhere, and the refusal is held against
//! the node. So nothing of it is ever learnt from or counted.

use bytes::Bytes;
use forelight_protocol::{ByClass, FinishedPixels, LeaseId, TaskError, TaskResult, TaskSpec, Timestamp};
use futures::TryStreamExt as _;

use crate::columns::Json;
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::leases::failing::{Report, fail};
use crate::leases::state::LeaseState;
use crate::leases::{LeaseInfo, read, read_in};
use crate::nodes;
use crate::policy::evidence::{Means, Objection, expected_files, objection, pixels_objection};
use crate::policy::faults::Fault;

/// While the service was down, the clock may have been set. So that much more time may have passed in a lease
/// of then: a day, in microseconds.
const UNKNOWN: i64 = 86_400_000_000;

/// How many bytes of a file say what it is.
const HEAD: usize = 64 << 10;

impl Store {
    /// Refuses a result that is not possible ([`StoreError::Implausible`]): its lease has failed then, and
    /// the task is ready again. Does nothing for a lease that is not active any more, whose result is
    /// refused or known anyhow.
    pub async fn check_evidence(
        &self,
        lease: LeaseId,
        fence: u64,
        result: &TaskResult,
        now: Timestamp,
    ) -> Result<()> {
        let row = read(&mut *self.readers().acquire().await?, lease).await?;
        if row.fence != fence || row.state != LeaseState::Active {
            return Ok(());
        }
        let info = self.lease(lease).await?;
        let taken_over = taken_over(&mut *self.readers().acquire().await?, &info).await?;
        let means = self.means(&info, taken_over, now).await?;
        let found = match objection(result, &means) {
            Some(found) => Some(found),
            None => self.wrong_file(&info.spec, result, now).await?,
        };
        let Some(found) = found else { return Ok(()) };
        self.refuse_result(lease, fence, &found, now).await?;
        Err(StoreError::Implausible { pointer: found.pointer, reason: found.reason })
    }

    /// Refuses finished pixels of a running frame whose cost is not possible: [`StoreError::Implausible`]. The
    /// lease stays. Pixels of the profile are among them, at the most for what the frame was quoted at.
    pub async fn check_pixels(&self, lease: LeaseId, pixels: &FinishedPixels, now: Timestamp) -> Result<()> {
        let info = self.lease(lease).await?;
        let quoted = sqlx::query_scalar!(
            "SELECT cpu_p95 FROM frames WHERE job_id = ? AND frame = ?",
            info.job_id.0,
            info.spec.frame()
        )
        .fetch_optional(self.readers())
        .await?;
        let means = self.means(&info, 0, now).await?;
        // The quote is for a node of speed 1. The float saturates.
        let quoted = (quoted.flatten().unwrap_or(0.0) * 1e9 / means.speed) as u64;
        let objection = |taken_over_nanos| pixels_objection(pixels, &Means { taken_over_nanos, ..means });
        if objection(quoted).is_none() {
            return Ok(());
        }
        // A frame may have taken more than it was quoted at, and its parts were paid for that.
        match objection(taken_over(&mut *self.readers().acquire().await?, &info).await?) {
            Some(found) => Err(StoreError::Implausible { pointer: found.pointer, reason: found.reason }),
            None => Ok(()),
        }
    }

    /// What the attempts at a task could do until now.
    async fn means(&self, info: &LeaseInfo, taken_over_nanos: u64, now: Timestamp) -> Result<Means> {
        let mut connection = self.readers().acquire().await?;
        let core_micros = sqlx::query_scalar!(
            "SELECT coalesce(sum((max(0, coalesce(l.ended_at, ?1) - l.granted_at) \
             + CASE WHEN l.counts_from IS NULL THEN 0 ELSE ?3 END) * n.cores), 0) AS \"micros!: i64\" \
             FROM leases l JOIN nodes n ON n.id = l.node_id WHERE l.task_id = ?2",
            now.micros(),
            info.task_id.0,
            UNKNOWN
        )
        .fetch_one(&mut *connection)
        .await?;
        let work = sqlx::query_scalar!("SELECT work_by_class FROM jobs WHERE id = ?", info.job_id.0)
            .fetch_one(&mut *connection)
            .await?;
        let work: Option<ByClass> = work.map(|Json(work)| work);
        let node = nodes::read(&mut connection, info.node_id).await?;
        let speed = node.speed_for(work.as_ref());
        Ok(Means { core_micros, cores: node.cores, taken_over_nanos, speed })
    }

    /// The first artefact that is not the image or the video that it should be. Artefacts that are not stored
    /// are left to the commit, which names them.
    async fn wrong_file(
        &self,
        spec: &TaskSpec,
        result: &TaskResult,
        now: Timestamp,
    ) -> Result<Option<Objection>> {
        for file in expected_files(spec, result) {
            let reader = match self.artifacts().get(file.hash, now).await {
                Ok(reader) => reader,
                Err(
                    StoreError::NotFound(_)
                    | StoreError::ArtifactLost { .. }
                    | StoreError::ArtifactDamaged { .. },
                ) => continue,
                Err(error) => return Err(error),
            };
            let head: Vec<Bytes> = reader.part(0..HEAD as u64).try_collect().await?;
            let head = head.concat();
            if let Some(found) = file.objection(&head) {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    /// Ends a lease whose result is not possible.
    async fn refuse_result(
        &self,
        lease: LeaseId,
        fence: u64,
        found: &Objection,
        now: Timestamp,
    ) -> Result<()> {
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        let message = format!("its result was refused: {} ({})", found.reason, found.pointer);
        let error = TaskError { message, ..TaskError::default() };
        let report = Report { error: &error, fault: Some(Fault::Refused) };
        fail(&mut write, &row, &report, now).await?;
        self.commit(write).await
    }
}

/// CPU time of what a frame or a part takes over, in nanoseconds: that of its profile, of its shares of
/// samples, and of the tasks of its parts.
async fn taken_over(connection: &mut sqlx::SqliteConnection, info: &LeaseInfo) -> Result<u64> {
    let (frame, is_whole) = match &info.spec {
        TaskSpec::Render(spec) => (spec.frame, true),
        TaskSpec::RenderPart(spec) => (spec.frame, false),
        _ => return Ok(0),
    };
    let shares = match &info.spec {
        TaskSpec::Render(spec) => &spec.shares[..],
        _ => &[],
    };
    let shares = shares.iter().fold(0u64, |sum, share| sum.saturating_add(share.cpu_nanos));
    let before = sqlx::query_scalar!(
        "SELECT sum(json_extract(r.body, '$.' || t.kind || '.spent.cpu_nanos') + t.earlier_nanos) AS \"nanos?: i64\" FROM tasks t \
         JOIN results r ON r.task_id = t.id WHERE t.job_id = ? AND t.frame = ? \
         AND (t.kind = 'profile' OR ? AND t.kind IN ('divide', 'cache_fill', 'cache_merge', 'render_part'))",
        info.job_id.0,
        frame,
        is_whole
    )
    .fetch_one(connection)
    .await?;
    let taken_over = before.and_then(|nanos| u64::try_from(nanos).ok()).unwrap_or(0);
    Ok(shares.saturating_add(taken_over))
}
