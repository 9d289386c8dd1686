//! Renewing and releasing leases.

use std::time::Duration;

use forelight_protocol::{
    Event, EventKind, FinishedPixels, LeaseId, LeaseOrder, RenewRequest, Renewal, TaskKind, Timestamp,
};

use crate::database::Store;
use crate::division;
use crate::error::Result;
use crate::events::append;
use crate::leases::state::LeaseState;
use crate::leases::{back_to_ready, end, logs, read_in};
use crate::living::{self, Occasion};
use crate::nodes::sleep_of;
use crate::writing::later;

/// Progress events are at least a hundredth apart: a worker that renews often must not fill the disk.
const PROGRESS_STEP: f64 = 0.01;

impl Store {
    /// Extends a lease to `ttl` from now, keeps what the worker reports, and answers with the operator's
    /// orders.
    pub async fn renew(
        &self,
        lease: LeaseId,
        request: &RenewRequest,
        ttl: Duration,
        now: Timestamp,
    ) -> Result<Renewal> {
        let &RenewRequest { fence, progress, pixels, paused, ref log } = request;
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        let sleep_until = sleep_of(write.connection().await?, row.node_id, row.has_calendar, now).await?;
        let drain = row.drain;
        let renewal =
            |expires_at, order, divide_rest| Renewal { expires_at, order, drain, sleep_until, divide_rest };
        if row.fence == fence && row.state == LeaseState::Revoked {
            return Ok(renewal(now, LeaseOrder::Stop, None));
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        let expires_at = now.plus_micros(i64::try_from(ttl.as_micros()).unwrap_or(i64::MAX));
        later!(
            write,
            "UPDATE leases SET expires_at = ?, paid_until = NULL, progress_at = CASE WHEN ? > progress THEN ? \
             ELSE progress_at END, progress = max(progress, ?), counts_from = CASE WHEN ? THEN ? ELSE counts_from END \
             WHERE id = ?",
            expires_at.micros(),
            progress,
            now.micros(),
            progress,
            // Only a pause that was ordered stops the time.
            paused && row.pause,
            now.micros(),
            lease.0
        );
        later!(
            write,
            "UPDATE nodes SET last_seen_at = max(last_seen_at, ?), paused = ? WHERE id = ?",
            now.micros(),
            paused,
            row.node_id.0
        );
        if progress >= row.progress + PROGRESS_STEP || (progress == 1.0 && row.progress < 1.0) {
            // Of two attempts, the newest is shown.
            later!(
                write,
                "UPDATE tasks SET progress = max(progress, ?) WHERE id = ? AND fence = ?",
                progress,
                row.task_id.0,
                fence as i64
            );
            append(&mut write, Event { progress: Some(progress), ..row.event(EventKind::TaskProgress, now) });
        }
        if let Some(FinishedPixels { done, all, work, cpu_nanos }) = pixels.filter(|pixels| pixels.all > 0) {
            later!(
                write,
                "UPDATE tasks SET pixels_share = ?, pixels_work = ?, pixels_cpu = ? \
                 WHERE id = ? AND fence = ?",
                (done as f64 / all as f64).min(1.0),
                work as f64,
                cpu_nanos as f64 * 1e-9 * row.node_speed,
                row.task_id.0,
                fence as i64
            );
            if let Some(frame) = row.frame.filter(|_| row.kind == TaskKind::RenderPart) {
                division::add_up(&mut write, row.job_id, frame).await?;
            }
            living::update(&mut write, row.job_id, Occasion::Meanwhile, now).await?;
        }
        logs::keep(&mut write, &row, log).await?;
        self.commit(write).await?;
        let order = if row.pause { LeaseOrder::Pause } else { LeaseOrder::Continue };
        Ok(renewal(expires_at, order, row.divide_rest))
    }

    /// Gives a task back unfinished. This counts neither as an error nor as an expiry. Does nothing if the
    /// lease was released or revoked before.
    pub async fn release(&self, lease: LeaseId, fence: u64, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        if row.fence == fence && matches!(row.state, LeaseState::Released | LeaseState::Revoked) {
            return Ok(());
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        end(&mut write, &row, "released", now);
        back_to_ready(&mut write, &row, None);
        append(&mut write, row.event(EventKind::LeaseReleased, now));
        self.commit(write).await
    }
}
