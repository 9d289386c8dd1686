//! Shares of the farm, and what projects used of it.

use std::collections::BTreeMap;

use forelight_protocol::{AuditAction, ProjectRequest, Timestamp};
use sqlx::SqliteConnection;

use crate::audit::{Deed, note, note_only};
use crate::budgets::past;
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::plans::replans;
use crate::writing::run;

/// Use counts half after this many microseconds: a week.
pub const HALF_LIFE: i64 = 7 * 24 * HOUR;

const HOUR: i64 = 3_600_000_000;

/// Use is forgotten after so many half-lives: less than a thousandth is left of it.
const REMEMBERED: i64 = 10;

/// A project's share, and what it used.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct ProjectUse {
    /// Its name.
    pub name: String,
    /// Its share, relative to the others'.
    pub share: u32,
    /// Node time in microseconds, by the hour in which it ended. Running leases end now.
    pub used: Vec<(Timestamp, i64)>,
}

/// A project that does not exist is a [`StoreError::NoProject`].
pub(crate) async fn check_exists(connection: &mut SqliteConnection, project: &str) -> Result<()> {
    let known = sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM projects WHERE name = ?) AS "exists!: bool""#,
        project
    );
    if known.fetch_one(connection).await? { Ok(()) } else { Err(StoreError::NoProject(project.to_owned())) }
}

/// Makes a project with a share of 1, unless it exists.
pub(crate) async fn make(write: &mut Write, project: &str, now: Timestamp) -> Result<()> {
    let made = run!(
        write,
        "INSERT INTO projects (name, share, updated_at) VALUES (?, 1, ?) ON CONFLICT (name) DO NOTHING",
        project,
        now.micros()
    );
    if made == 1 {
        note_only(write, Deed::new(AuditAction::ProjectSet, project).of_project(project), now);
    }
    Ok(())
}

impl Store {
    /// Sets a project's share, making it if it does not exist, and calls for a new plan.
    pub async fn set_share(&self, request: &ProjectRequest, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        run!(
            write,
            "INSERT INTO projects (name, share, updated_at) VALUES (?, ?, ?) \
             ON CONFLICT (name) DO UPDATE SET share = excluded.share, updated_at = excluded.updated_at",
            &request.project,
            request.share,
            now.micros()
        );
        let deed = Deed::new(AuditAction::ProjectSet, &request.project).of_project(&request.project);
        note(&mut write, deed, Some(request), now);
        let cause = format!("the share of project {} is {}", request.project, request.share);
        replans::want(&mut write, &cause).await?;
        self.commit(write).await
    }

    /// All projects, by name.
    pub async fn projects(&self, now: Timestamp) -> Result<Vec<ProjectUse>> {
        read(&mut *self.read().await?, now).await
    }
}

pub(crate) async fn read(connection: &mut SqliteConnection, now: Timestamp) -> Result<Vec<ProjectUse>> {
    let mut found: BTreeMap<String, ProjectUse> = BTreeMap::new();
    let rows = sqlx::query!(
        "SELECT name AS \"name!\", max(share) AS \"share!: u32\" FROM (SELECT name, share FROM projects \
         UNION ALL SELECT project, 0 FROM jobs WHERE stage IN ('previewing', 'profiling', 'booked', \
         'rendering')) GROUP BY name"
    )
    .fetch_all(&mut *connection)
    .await?;
    for row in rows {
        let entry = ProjectUse { name: row.name.clone(), share: row.share.max(1), used: Vec::new() };
        found.insert(row.name, entry);
    }
    let since = now.plus_micros(-REMEMBERED * HALF_LIFE);
    let ended = sqlx::query!(
        "SELECT project, (until_at + ?3 - 1) / ?3 AS \"hour!: i64\", sum(until_at - from_at) AS \"used!: i64\" \
         FROM ledger WHERE until_at > ?2 AND from_at < ?1 GROUP BY 1, 2 ORDER BY 1, 2",
        now.micros(),
        since.micros(),
        HOUR
    )
    .fetch_all(&mut *connection)
    .await?;
    let running = sqlx::query!(
        "SELECT project, (ends_at + ?2 - 1) / ?2 AS \"hour!: i64\", sum(ends_at - from_at) AS \"used!: i64\" \
         FROM (SELECT project, from_at, coalesce(paid_until, min(?1, expires_at)) AS ends_at \
         FROM ledger d JOIN leases l ON l.id = d.lease_id WHERE until_at IS NULL AND from_at < ?1) \
         GROUP BY 1, 2 ORDER BY 1, 2",
        now.micros(),
        HOUR
    )
    .fetch_all(&mut *connection)
    .await?;
    let past = past::used(connection, since, HOUR).await?;
    let hour = |hour: i64| Timestamp::from_micros(hour.saturating_mul(HOUR));
    let ended = ended.into_iter().map(|row| (row.project, hour(row.hour), row.used));
    let running = running.into_iter().map(|row| (row.project, hour(row.hour), row.used));
    for (project, hour, used) in ended.chain(running).chain(past) {
        let entry = found.entry(project);
        let name = entry.key().clone();
        entry.or_insert(ProjectUse { name, share: 1, used: Vec::new() }).used.push((hour.min(now), used));
    }
    Ok(found.into_values().collect())
}
