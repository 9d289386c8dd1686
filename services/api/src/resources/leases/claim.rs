use std::time::Duration;

use forelight_protocol::{ClaimRequest, Lease, Timestamp};
use forelight_store::{Answered, IdempotencyKey};
use tokio::time::Instant;

use crate::error::ApiResult;
use crate::state::App;

/// A task is looked for this much after it is due, so that it is certainly due.
const RETRY_MARGIN: Duration = Duration::from_millis(5);

pub(super) enum Claimed {
    Lease(Box<Answered<Lease>>),
    /// No task is available.
    Nothing,
    /// The node is asleep until then and need not ask before.
    Asleep(Timestamp),
}

/// Claims a task for the node, and waits for one if needed. A node that is asleep by its calendar does not
/// wait.
///
/// Hazards with many waiting workers:
///
/// - A task may become ready between looking and waiting, so the watch is marked as seen *before* looking.
/// - One ready task must not make a hundred workers queue for the write lock, so woken workers first look
///   without it.
/// - No event announces an expired lease, so the wait is split into pieces of half a lease, or until a failed
///   task is due. After each piece the node is noted as alive.
/// - A stopping service must not wait for its waiting workers.
pub(super) async fn wait_for_task(
    app: &App,
    request: &ClaimRequest,
    key: Option<&IdempotencyKey>,
) -> ApiResult<Claimed> {
    let until = Instant::now() + Duration::from_millis(u64::from(request.wait_ms));
    let piece = (app.lease_ttl / 2).max(Duration::from_millis(50));
    let mut work = app.store.watch_work();
    loop {
        work.borrow_and_update();
        if let Some(worker) = request.worker {
            app.store.check_worker(request.node_id, worker).await?;
        }
        let room = app.check_disk_space();
        let no_step = app.clock_steps.read().await;
        let (node, ttl, now) = (request.node_id, app.lease_ttl, app.now());
        let claimed = match request.task_id {
            wanted if room.is_err() => app.store.claim_nothing_new(node, wanted, key, now).await?,
            Some(task) => app.store.claim_task(node, task, ttl, key, now).await?,
            None => app.store.claim(node, ttl, key, now).await?,
        };
        drop(no_step);
        if let Some(lease) = claimed {
            app.metrics.leases_granted.add(u64::from(matches!(lease, Answered::Fresh(_))));
            return Ok(Claimed::Lease(Box::new(lease)));
        }
        if request.task_id.is_none()
            && let Some(until) = app.store.sleeps_until(request.node_id, app.now()).await?
        {
            return Ok(Claimed::Asleep(until));
        }
        room?;
        loop {
            let retry = match app.store.next_retry(app.now()).await? {
                Some(due) => {
                    Duration::from_micros(due.micros_since(app.now()).max(0).unsigned_abs()) + RETRY_MARGIN
                }
                None => piece,
            };
            let pause = until.min(Instant::now() + piece.min(retry));
            let announced = tokio::select! {
                changed = work.changed() => { if changed.is_err() { return Ok(Claimed::Nothing) } true }
                () = tokio::time::sleep_until(pause) => false,
                () = app.stopping.cancelled() => return Ok(Claimed::Nothing),
            };
            if Instant::now() >= until && !announced {
                return Ok(Claimed::Nothing);
            }
            if !announced || app.store.may_have_work(request.node_id, request.task_id, app.now()).await? {
                break;
            }
        }
    }
}
