//! Maintenance of leases: takes back the tasks of lost workers, and corrects times if the clock was set.

use std::time::Duration;

use forelight_protocol::Timestamp;

use crate::database::{Store, Write};
use crate::error::Result;
use crate::events::forget_old_progress;
use crate::idempotency::forget_old;
use crate::jobs::versions::replace_lost;
use crate::leases::losing::lose;
use crate::leases::state::LeaseState;
use crate::leases::{ran_out, read_in};
use crate::living;
use crate::nodes::changing::stop_after_windows;
use crate::policy::retries::LONGEST_WAIT;
use crate::rights::forget_ended_rights;
use crate::sessions::forget_ended_sessions;
use crate::tokens::forget_expired_tokens;
use crate::webhooks::forget_old_deliveries;
use crate::writing::run;

/// The result of a sweep.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Swept {
    /// Leases that had expired.
    pub expired: u32,
    /// Jobs that failed because a task lost its worker too often.
    pub jobs_failed: u32,
}

impl Store {
    /// Takes back the tasks of expired leases, looks at those that take too long, updates overdue estimates,
    /// replaces versions of our renderer that no node has any more, and deletes records past their time.
    pub async fn sweep(&self, now: Timestamp) -> Result<Swept> {
        let mut swept = Swept::default();
        loop {
            let mut write = self.write().await?;
            let (some, are_left) = sweep(&mut write, now).await?;
            self.commit(write).await?;
            swept.expired += some.expired;
            swept.jobs_failed += some.jobs_failed;
            if !are_left {
                break;
            }
        }
        let mut write = self.write().await?;
        stop_after_windows(&mut write, now).await?;
        living::catch_up(&mut write, now).await?;
        replace_lost(&mut write, self.up_since(), now).await?;
        forget_old(&mut write, now).await?;
        forget_old_progress(&mut write, now).await?;
        forget_ended_sessions(&mut write, now).await?;
        forget_expired_tokens(&mut write, now).await?;
        forget_ended_rights(&mut write).await?;
        forget_old_deliveries(&mut write, now).await?;
        self.commit(write).await?;
        self.look_at_running(now).await?;
        self.divide_late_parts(now).await?;
        self.forget_checkpoints().await?;
        Ok(swept)
    }

    /// Gives every active lease one more term, from now. A service calls this once when it starts, before the
    /// first sweep: workers could not renew while it was down.
    ///
    /// The time before does not count for tasks that are late. If the clock was set back meanwhile, which
    /// shows in the newest event, no lease lasts longer for it, no failed task waits longer than the longest
    /// wait, and what was spent does not fall. A worker that stays silent is paid until its lease would have
    /// expired.
    pub async fn extend_leases_after_start(&self, ttl: Duration, now: Timestamp) -> Result<u64> {
        let until = now.plus_micros(i64::try_from(ttl.as_micros()).unwrap_or(i64::MAX));
        if let Some(newest) = self.time_of_newest_event().await?.filter(|&newest| newest > now) {
            self.clock_was_set(now.micros_since(newest)).await?;
        }
        self.set_up_since(now);
        let mut write = self.write().await?;
        let extended = run!(
            write,
            "UPDATE leases SET paid_until = min(coalesce(paid_until, expires_at), ?1), expires_at = ?2, \
             counts_from = ?1 WHERE state = 'active'",
            now.micros(),
            until.micros()
        );
        run!(
            write,
            "UPDATE tasks SET not_before = ?1 WHERE state = 'ready' AND not_before > ?1",
            now.plus_micros(LONGEST_WAIT).micros()
        );
        self.commit(write).await?;
        Ok(extended)
    }

    /// Corrects times after the clock was set forward by so many microseconds (back, if negative).
    pub async fn clock_was_set(&self, micros: i64) -> Result<()> {
        let mut write = self.write().await?;
        run!(
            write,
            "UPDATE leases SET granted_at = granted_at + ?1, expires_at = expires_at + ?1, paid_until = \
             paid_until + ?1, progress_at = progress_at + ?1, counts_from = counts_from + ?1 \
             WHERE state = 'active'",
            micros
        );
        run!(
            write,
            "UPDATE tasks SET not_before = max(1, not_before + ?) WHERE state = 'ready' AND not_before > 0",
            micros
        );
        // Otherwise a node that was last heard of in what is now the future would look alive too long.
        run!(write, "UPDATE nodes SET last_seen_at = last_seen_at + ?1 WHERE ?1 < 0", micros);
        // Running leases are paid for the time that passed, not for the step of the clock.
        run!(write, "UPDATE ledger SET from_at = from_at + ? WHERE until_at IS NULL", micros);
        run!(write, "UPDATE tasks SET started_at = started_at + ? WHERE state = 'leased'", micros);
        self.set_up_since(self.up_since().plus_micros(micros));
        self.commit(write).await
    }
}

/// Expired leases that are looked at in one write. Thousands may expire at once, and workers that wait while
/// somebody writes could lose theirs as well.
const AT_ONCE: u32 = 50;

/// Takes back the tasks of some expired leases. Returns whether there may be more.
pub(crate) async fn sweep(write: &mut Write, now: Timestamp) -> Result<(Swept, bool)> {
    let mut swept = Swept::default();
    let rows = ran_out(write, now, AT_ONCE).await?;
    let are_left = rows.len() == AT_ONCE as usize;
    for row in rows {
        // An earlier row of this sweep may have failed the job and so revoked this lease.
        if read_in(write, row.id).await?.state != LeaseState::Active {
            continue;
        }
        swept.expired += 1;
        swept.jobs_failed += u32::from(lose(write, &row, false, now).await?);
    }
    Ok((swept, are_left))
}
