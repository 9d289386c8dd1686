//! Shares of the farm, and what projects had of it.

use std::collections::BTreeMap;

use forelight_protocol::{ProjectRequest, Timestamp};
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::decode::whole;
use crate::error::StoreError;
use crate::leases::paid_until;
use crate::plans::replans;

/// After this many microseconds, what a project used counts half: a week.
pub const HALF_LIFE: i64 = 7 * 24 * HOUR;

const HOUR: i64 = 3_600_000_000;

/// What was used longer ago than so many half-lives counts as nothing: a thousandth is left of it.
const REMEMBERED: i64 = 10;

/// A project's share, and what it used.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct ProjectUse {
    /// Its name.
    pub name: String,
    /// Its share, relative to the others'.
    pub share: u32,
    /// Node time that it had, in microseconds, by the hour in which it ended; what runs ends now.
    pub used: Vec<(Timestamp, i64)>,
}

impl Store {
    /// Sets a project's share. It calls for a new plan.
    pub async fn set_share(&self, request: &ProjectRequest, now: Timestamp) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        sqlx::query(
            "INSERT INTO projects (name, share, updated_at) VALUES (?, ?, ?) \
             ON CONFLICT (name) DO UPDATE SET share = excluded.share, updated_at = excluded.updated_at",
        )
        .bind(&request.project)
        .bind(i64::from(request.share))
        .bind(now.micros())
        .execute(write.connection().await?)
        .await?;
        let cause = format!("the share of project {} is {}", request.project, request.share);
        replans::want(&mut write, &cause).await?;
        self.commit(write).await
    }

    /// All projects that have a share, an open job, or used the farm lately, by name.
    pub async fn projects(&self, now: Timestamp) -> Result<Vec<ProjectUse>, StoreError> {
        let mut transaction = self.read().await?;
        read(&mut transaction, now).await
    }
}

pub(crate) async fn read(
    connection: &mut SqliteConnection,
    now: Timestamp,
) -> Result<Vec<ProjectUse>, StoreError> {
    let mut found: BTreeMap<String, ProjectUse> = BTreeMap::new();
    let rows = sqlx::query(
        "SELECT name, max(share) AS share FROM (SELECT name, share FROM projects UNION ALL \
         SELECT project, 0 FROM jobs WHERE state IN ('previewing', 'profiling', 'booked', 'rendering')) GROUP BY name",
    )
    .fetch_all(&mut *connection)
    .await?;
    for row in &rows {
        let name: String = row.try_get("name")?;
        let share = whole::<u32>(row, "share")?.max(1);
        found.insert(name.clone(), ProjectUse { name, share, used: Vec::new() });
    }
    let rows = sqlx::query(concat!(
        "SELECT project, (ends_at + ?3 - 1) / ?3 AS hour, sum(ends_at - from_at) AS used FROM \
         (SELECT project, from_at, coalesce(until_at, ",
        paid_until!("?1"),
        ") AS ends_at FROM ledger d JOIN leases l ON l.id = d.lease_id \
         WHERE from_at < ?1 AND (until_at IS NULL OR until_at > ?2)) GROUP BY project, hour ORDER BY project, hour",
    ))
    .bind(now.micros())
    .bind(now.plus_micros(-REMEMBERED * HALF_LIFE).micros())
    .bind(HOUR)
    .fetch_all(connection)
    .await?;
    for row in &rows {
        let name: String = row.try_get("project")?;
        let (hour, used): (i64, i64) = (row.try_get("hour")?, row.try_get("used")?);
        let entry = found.entry(name.clone()).or_insert(ProjectUse { name, share: 1, used: Vec::new() });
        entry.used.push((Timestamp::from_micros(hour.saturating_mul(HOUR)).min(now), used));
    }
    Ok(found.into_values().collect())
}
