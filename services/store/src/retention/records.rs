//! Deletes lines of logs, events, plans, scenes and entries of the audit that are past their time.

use forelight_protocol::{AuditAction, RetentionKind, Timestamp};

use crate::audit::{Deed, note};
use crate::database::Store;
use crate::error::Result;
use crate::policy::retention::Rules;
use crate::writing::run;

/// Most rows that one write deletes.
const SLICE: i64 = 5000;

/// Deletes one slice after another, each in a write of its own, until nothing is left. The last parameter of the
/// statement is the length of a slice. Gives how many rows were deleted.
macro_rules! delete_in_slices {
    ($store:expr, $statement:literal, $value:expr $(,)?) => {{
        let mut deleted = 0;
        loop {
            let mut write = $store.write().await?;
            let number = run!(write, $statement, $value, SLICE);
            $store.commit(write).await?;
            deleted += number;
            if number == 0 {
                break Ok(deleted);
            }
        }
    }};
}

impl Store {
    /// Deletes logs, events, plans or entries of the audit. Returns how many.
    pub(super) async fn prune_records(
        &self,
        kind: RetentionKind,
        rules: &Rules,
        dry_run: bool,
        now: Timestamp,
    ) -> Result<u64> {
        let Some(cut) = rules.cut(kind, None, now) else { return Ok(0) };
        match (kind, dry_run) {
            (RetentionKind::Logs, true) => self.count_logs(cut).await,
            (RetentionKind::Logs, false) => self.prune_logs(cut).await,
            (RetentionKind::Events, true) => self.count_events(cut).await,
            (RetentionKind::Events, false) => self.prune_events(cut).await,
            (RetentionKind::Audit, true) => self.count_audit(cut).await,
            (RetentionKind::Audit, false) => self.prune_audit(cut, now).await,
            (_, true) => Ok(self.past_plans(cut).await?.len() as u64),
            (_, false) => self.prune_plans(cut).await,
        }
    }

    async fn count_logs(&self, cut: Timestamp) -> Result<u64> {
        let number = sqlx::query_scalar!(
            r#"SELECT count(*) AS "number!: u64" FROM task_logs WHERE at < ?"#,
            cut.micros()
        );
        Ok(number.fetch_one(self.readers()).await?)
    }

    async fn prune_logs(&self, cut: Timestamp) -> Result<u64> {
        delete_in_slices!(
            self,
            "DELETE FROM task_logs WHERE (task_id, fence, number) IN \
             (SELECT task_id, fence, number FROM task_logs WHERE at < ? ORDER BY at LIMIT ?)",
            cut.micros()
        )
    }

    async fn count_audit(&self, cut: Timestamp) -> Result<u64> {
        let number =
            sqlx::query_scalar!(r#"SELECT count(*) AS "number!: u64" FROM audit WHERE at < ?"#, cut.micros());
        Ok(number.fetch_one(self.readers()).await?)
    }

    /// Deletes old entries of the audit. An entry says that, so that a gap is never silent.
    async fn prune_audit(&self, cut: Timestamp, now: Timestamp) -> Result<u64> {
        let deleted: Result<u64> = delete_in_slices!(
            self,
            "DELETE FROM audit WHERE id IN (SELECT id FROM audit WHERE at < ? ORDER BY at LIMIT ?)",
            cut.micros()
        );
        let deleted = deleted?;
        if deleted > 0 {
            let mut write = self.write().await?;
            let detail = serde_json::json!({"entries": deleted, "before": cut});
            note(&mut write, Deed::new(AuditAction::AuditPruned, "audit"), Some(&detail), now);
            self.commit(write).await?;
        }
        Ok(deleted)
    }

    /// The first event that stays, if any is older. Events are numbered in the order of time.
    async fn first_event(&self, cut: Timestamp) -> Result<i64> {
        let first = sqlx::query_scalar!(
            r#"SELECT coalesce((SELECT id FROM events WHERE at >= ? ORDER BY id LIMIT 1),
                               (SELECT max(id) + 1 FROM events), 0) AS "first!: i64""#,
            cut.micros()
        );
        Ok(first.fetch_one(self.readers()).await?)
    }

    async fn count_events(&self, cut: Timestamp) -> Result<u64> {
        let first = self.first_event(cut).await?;
        let number =
            sqlx::query_scalar!(r#"SELECT count(*) AS "number!: u64" FROM events WHERE id < ?"#, first);
        Ok(number.fetch_one(self.readers()).await?)
    }

    async fn prune_events(&self, cut: Timestamp) -> Result<u64> {
        let first = self.first_event(cut).await?;
        delete_in_slices!(
            self,
            "DELETE FROM events WHERE id IN (SELECT id FROM events WHERE id < ? ORDER BY id LIMIT ?)",
            first
        )
    }

    /// Old plans that no job and no estimate refers to, oldest first; never the newest.
    async fn past_plans(&self, cut: Timestamp) -> Result<Vec<uuid::Uuid>> {
        let plans = sqlx::query_scalar!(
            "SELECT id FROM plans p WHERE created_at < ? AND id <> (SELECT max(id) FROM plans) \
             AND NOT EXISTS (SELECT 1 FROM jobs WHERE plan_id = p.id) \
             AND NOT EXISTS (SELECT 1 FROM live_forecasts WHERE plan_id = p.id) ORDER BY id",
            cut.micros()
        );
        Ok(plans.fetch_all(self.readers()).await?.into_iter().map(|plan| plan.0).collect())
    }

    async fn prune_plans(&self, cut: Timestamp) -> Result<u64> {
        let mut deleted = 0;
        for plan in self.past_plans(cut).await? {
            let mut write = self.write().await?;
            // Within this write, triggers let the plan and its bookings go. A job may refer to it by now.
            run!(
                write,
                "INSERT INTO deleted_plans (id) SELECT ?1 \
                 WHERE NOT EXISTS (SELECT 1 FROM jobs WHERE plan_id = ?1) \
                 AND NOT EXISTS (SELECT 1 FROM live_forecasts WHERE plan_id = ?1)",
                plan
            );
            run!(write, "DELETE FROM bookings WHERE plan_id IN (SELECT id FROM deleted_plans)");
            run!(write, "DELETE FROM shared_cache_bookings WHERE plan_id IN (SELECT id FROM deleted_plans)");
            run!(
                write,
                "UPDATE plans SET parent_id = NULL WHERE parent_id IN (SELECT id FROM deleted_plans)"
            );
            deleted += run!(write, "DELETE FROM plans WHERE id IN (SELECT id FROM deleted_plans)");
            run!(write, "DELETE FROM deleted_plans");
            self.commit(write).await?;
        }
        Ok(deleted)
    }

    /// Lets the files of uploaded scenes go that no open job uses. A scene that no job refers to goes as a
    /// whole. Returns how many scenes these are, and the size of their files.
    pub(super) async fn prune_scenes(
        &self,
        rules: &Rules,
        dry_run: bool,
        now: Timestamp,
    ) -> Result<(u64, u64)> {
        let Some(cut) = rules.cut(RetentionKind::Scenes, None, now) else { return Ok((0, 0)) };
        let rows = sqlx::query!(
            r#"SELECT b.id, a.size AS "size?: u64",
                      NOT EXISTS (SELECT 1 FROM jobs WHERE bundle_id = b.id) AS "is_free!: bool"
               FROM bundles b LEFT JOIN artifacts a ON a.hash = b.hash
               WHERE b.created_at < ?1 AND NOT EXISTS (
                   SELECT 1 FROM jobs WHERE bundle_id = b.id AND (finished_at IS NULL OR finished_at >= ?1))"#,
            cut.micros()
        )
        .fetch_all(self.readers())
        .await?;
        let (mut number, mut bytes) = (0, 0);
        for row in rows.into_iter().filter(|row| row.size.is_some() || row.is_free) {
            number += 1;
            bytes += row.size.unwrap_or_default();
            if dry_run {
                continue;
            }
            let mut write = self.write().await?;
            run!(
                write,
                "DELETE FROM bundles WHERE id = ?1 AND NOT EXISTS (SELECT 1 FROM jobs WHERE bundle_id = ?1)",
                row.id
            );
            // A job may have been submitted with it by now.
            run!(
                write,
                "UPDATE bundles SET hash = NULL WHERE id = ?1 AND NOT EXISTS \
                 (SELECT 1 FROM jobs WHERE bundle_id = ?1 AND (finished_at IS NULL OR finished_at >= ?2))",
                row.id,
                cut.micros()
            );
            self.commit(write).await?;
        }
        Ok((number, bytes))
    }

    /// Gives pages of the database that became free back to the file system.
    pub(super) async fn give_back_pages(&self) -> Result<()> {
        let mut before = i64::MAX;
        loop {
            let mut write = self.write().await?;
            let connection = write.connection().await?;
            // Pragmas cannot be checked at compile time.
            sqlx::query("PRAGMA incremental_vacuum(2000)").fetch_all(&mut *connection).await?;
            let free: i64 = sqlx::query_scalar("PRAGMA freelist_count").fetch_one(connection).await?;
            self.commit(write).await?;
            // A database of an older version cannot shrink in place.
            if free == 0 || free >= before {
                return Ok(());
            }
            before = free;
        }
    }
}
