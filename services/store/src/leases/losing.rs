//! Records that a task lost its worker: it fell silent, or another worker took its node over.

use forelight_protocol::{EventKind, FailureKind, NodeId, Timestamp};

use crate::database::Write;
use crate::error::Result;
use crate::events::append;
use crate::jobs::ending::fail_task_and_job;
use crate::leases::failing::{TriedOn, could_another};
use crate::leases::state::LeaseState;
use crate::leases::{LeaseRow, active_leases_of, back_to_ready, end, read_in};
use crate::policy::retries::job_error_of_lost_workers;
use crate::writing::run;

/// Ends an active lease whose worker is lost. Its task is tried again, on another node first. A worker that `crashed`
/// is held against its node if others do the task. Returns whether the job fails instead.
pub(crate) async fn lose(write: &mut Write, row: &LeaseRow, crashed: bool, now: Timestamp) -> Result<bool> {
    end(write, row, "expired", now);
    append(write, row.event(EventKind::LeaseExpired, now));
    let another = could_another(write, row, TriedOn::FailedOrLost, now).await?;
    run!(
        write,
        "UPDATE leases SET alone = ?, failure = ? WHERE id = ?",
        !another,
        crashed.then(|| FailureKind::Unknown.name()),
        row.id.0
    );
    let expiries = row.expiries + 1;
    run!(
        write,
        "UPDATE tasks SET expiries = ?, not_before = max(not_before, ?) WHERE id = ?",
        expiries,
        now.micros(),
        row.task_id.0
    );
    let nodes = sqlx::query_scalar!(
        "SELECT DISTINCT n.name FROM tasks t JOIN leases l ON l.task_id = t.id JOIN nodes n ON n.id = l.node_id \
         WHERE t.id = ? AND l.state = 'expired' AND l.fence > t.begun_anew ORDER BY n.name",
        row.task_id.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    match job_error_of_lost_workers(expiries, &nodes, another) {
        Some(error) => fail_task_and_job(write, row, &error, now).await.map(|()| true),
        None => {
            back_to_ready(write, row, None);
            Ok(false)
        }
    }
}

/// The tasks of a node lose their worker, because another has taken the node over.
pub(crate) async fn lose_tasks_of(write: &mut Write, node: NodeId, now: Timestamp) -> Result<()> {
    for lease in active_leases_of(write, node).await? {
        let row = read_in(write, lease).await?;
        // The one before may have failed the job, and so revoked this one.
        if row.state == LeaseState::Active {
            // Machines are switched off, but a worker that had to be started again has crashed.
            lose(write, &row, true, now).await?;
        }
    }
    Ok(())
}
