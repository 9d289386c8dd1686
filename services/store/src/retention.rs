//! What the farm keeps, and for how long. Once a night, what is past its time is deleted.
//!
//! | module | deletes |
//! | --- | --- |
//! | `jobs` | images and profiles of jobs, and whole jobs |
//! | `records` | logs, events, plans, scenes, the audit |
//! | `crate::artifacts::collecting` | files that nothing refers to any more |
//!
//! Every write deletes little, so that others have their turn in between. A service that dies meanwhile goes
//! on the next night: each step finds by itself what is left to do.

mod jobs;
mod records;

use forelight_protocol::{
    AuditAction, Pruned, PrunedKind, Retention, RetentionKind, RetentionRule, Timestamp,
};

use crate::audit::{Deed, note};
use crate::columns::Json;
use crate::database::Store;
use crate::error::Result;
use crate::policy::retention::Rules;
use crate::projects;
use crate::writing::run;

impl Store {
    /// The rules in force, and what was deleted last.
    pub async fn retention(&self) -> Result<Retention> {
        let last = sqlx::query_scalar!("SELECT body FROM last_prune").fetch_optional(self.readers()).await?;
        Ok(Retention { items: self.rules().await?.in_force(), last: last.map(|it| it.0) })
    }

    /// Sets a rule. It replaces the one about the same. Its project must exist.
    pub async fn set_retention(&self, rule: &RetentionRule, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        if let Some(project) = &rule.project {
            projects::check_exists(write.connection().await?, project).await?;
        }
        run!(
            write,
            "INSERT INTO retention (project, kind, days) VALUES (?, ?, ?) \
             ON CONFLICT (project, kind) DO UPDATE SET days = excluded.days",
            rule.project.as_deref().unwrap_or_default(),
            rule.kind.name(),
            rule.days
        );
        let deed = Deed::new(AuditAction::RetentionSet, rule.kind.name());
        let deed = Deed { project: rule.project.as_deref(), ..deed };
        note(&mut write, deed, Some(rule), now);
        self.commit(write).await
    }

    /// Deletes what is past its time, or only says what that is.
    pub async fn prune(&self, dry_run: bool, now: Timestamp) -> Result<Pruned> {
        let rules = self.rules().await?;
        let mut items = Vec::new();
        for kind in RetentionKind::ALL {
            let (number, bytes) = match kind {
                RetentionKind::Logs | RetentionKind::Events | RetentionKind::Plans | RetentionKind::Audit => {
                    (self.prune_records(kind, &rules, dry_run, now).await?, 0)
                }
                RetentionKind::Scenes => self.prune_scenes(&rules, dry_run, now).await?,
                RetentionKind::Images | RetentionKind::Profiles | RetentionKind::Jobs => {
                    self.prune_jobs(kind, &rules, dry_run, now).await?
                }
            };
            items.push(PrunedKind { kind, number, bytes });
        }
        let (deleted, waiting) = self.artifacts().collect(dry_run, now).await?;
        let pruned = Pruned { at: now, dry_run, items, deleted, waiting };
        if !dry_run {
            let mut write = self.write().await?;
            run!(
                write,
                "INSERT INTO last_prune (one, at, body) VALUES (1, ?, ?) \
                 ON CONFLICT DO UPDATE SET at = excluded.at, body = excluded.body",
                now.micros(),
                Json(&pruned)
            );
            self.commit(write).await?;
            self.give_back_pages().await?;
        }
        Ok(pruned)
    }

    /// When [`Self::prune`] deleted last.
    pub async fn last_prune(&self) -> Result<Option<Timestamp>> {
        let at = sqlx::query_scalar!("SELECT at FROM last_prune").fetch_optional(self.readers()).await?;
        Ok(at.map(Timestamp::from_micros))
    }

    async fn rules(&self) -> Result<Rules> {
        let rows = sqlx::query!(
            r#"SELECT project, kind, days AS "days?: u32" FROM retention ORDER BY project, kind"#
        )
        .fetch_all(self.readers())
        .await?;
        let rule = |(project, kind, days): (String, RetentionKind, Option<u32>)| RetentionRule {
            project: (!project.is_empty()).then_some(project),
            kind,
            days,
        };
        Ok(Rules(rows.into_iter().map(|row| rule((row.project, row.kind.0, row.days))).collect()))
    }
}
