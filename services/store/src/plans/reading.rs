//! Reading plans.

use std::collections::BTreeSet;

use forelight_protocol::{Booking, JobId, JobVerdict, Plan, PlanId, PlanSummary};
use futures::TryStreamExt as _;
use sqlx::SqliteConnection;

use crate::columns::Json;
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::shared_cache::parts;

impl Store {
    /// The plans, newest first, after the one that `before` names, at most `limit`. If `projects` are given: the
    /// plans that book a job of these, with the number of such bookings. None if `before` was deleted, as older ones
    /// were.
    pub async fn plans(
        &self,
        before: Option<PlanId>,
        limit: u32,
        projects: Option<&[String]>,
    ) -> Result<Vec<PlanSummary>> {
        let rows = sqlx::query!(
            r#"SELECT p.id, p.parent_id, p.reason, p.causes, p.created_at,
                      (SELECT count(*) FROM bookings b WHERE b.plan_id = p.id AND (?3 IS NULL OR b.job_id IN
                       (SELECT id FROM jobs WHERE project IN (SELECT value FROM json_each(?3))))) AS "bookings!: u64"
               FROM plans p
               WHERE (?1 IS NULL OR p.rowid < (SELECT rowid FROM plans WHERE id = ?1))
               AND (?3 IS NULL OR EXISTS (SELECT 1 FROM bookings b JOIN jobs j ON j.id = b.job_id
                    WHERE b.plan_id = p.id AND j.project IN (SELECT value FROM json_each(?3))))
               ORDER BY p.rowid DESC LIMIT ?2"#,
            before.map(|plan| plan.0),
            limit,
            projects.map(Json)
        )
        .fetch_all(self.readers())
        .await?;
        Ok(rows
            .into_iter()
            .map(|row| PlanSummary {
                id: row.id.into(),
                parent_id: row.parent_id.map(Into::into),
                reason: row.reason.0,
                causes: row.causes.0,
                created_at: row.created_at.into(),
                bookings: row.bookings,
            })
            .collect())
    }

    /// The last bookings and verdicts that earlier plans gave to each job of this plan.
    pub async fn booked_before(&self, plan: PlanId) -> Result<(Vec<Booking>, Vec<JobVerdict>)> {
        let mut transaction = self.read().await?;
        let rows = sqlx::query!(
            r#"SELECT j.id, j.created_at FROM plans, json_each(plans.verdicts) v
               JOIN jobs j ON j.id = unhex(replace(v.value ->> 'job_id', '-', '')) WHERE plans.id = ?"#,
            plan.0
        )
        .fetch_all(&mut *transaction)
        .await?;
        let since = rows.iter().map(|row| row.created_at).min();
        let mut open: BTreeSet<JobId> = rows.into_iter().map(|row| row.id.into()).collect();
        let (mut found, mut verdicts) = (Vec::new(), Vec::new());
        // From the newest on, and no further than needed: a farm keeps thousands of plans.
        let mut plans = sqlx::query!(
            "SELECT id, verdicts FROM plans WHERE rowid < (SELECT rowid FROM plans WHERE id = ?) AND created_at >= ? \
             ORDER BY rowid DESC",
            plan.0,
            since
        )
        .fetch(&mut *transaction);
        while !open.is_empty()
            && let Some(before) = plans.try_next().await?
        {
            for verdict in before.verdicts.0 {
                if open.remove(&verdict.job_id) {
                    found.push((PlanId::from(before.id), verdict.job_id));
                    verdicts.push(verdict);
                }
            }
        }
        drop(plans);
        let mut bookings = Vec::new();
        for (before, job) in found {
            bookings.extend(bookings_of(&mut transaction, before, job).await?);
        }
        Ok((bookings, verdicts))
    }

    /// The newest plan; `None` before the first.
    pub async fn newest_plan(&self) -> Result<Option<PlanId>> {
        newest(&mut *self.readers().acquire().await?).await
    }

    /// A plan.
    pub async fn plan(&self, plan: PlanId) -> Result<Plan> {
        let mut transaction = self.read().await?;
        let row = sqlx::query!("SELECT * FROM plans WHERE id = ?", plan.0)
            .fetch_optional(&mut *transaction)
            .await?;
        let row = row.ok_or(StoreError::NotFound("plan"))?;
        let bookings = sqlx::query_as!(
            Booking,
            r#"SELECT id, plan_id, job_id, frame, part, parts, node_id, start_at AS start, end_at AS "end" FROM bookings
               WHERE plan_id = ? ORDER BY start_at, id"#,
            plan.0
        )
        .fetch_all(&mut *transaction)
        .await?;
        let shared_cache_bookings = parts::of_plan(&mut transaction, plan.0).await?;
        Ok(Plan {
            id: plan,
            parent_id: row.parent_id.map(Into::into),
            reason: row.reason.0,
            causes: row.causes.0,
            created_at: row.created_at.into(),
            verdicts: row.verdicts.0,
            bookings,
            shared_cache_bookings,
        })
    }
}

pub(crate) async fn newest(connection: &mut SqliteConnection) -> Result<Option<PlanId>> {
    // By row number, not by id: ids sort by the clock, which may have been set back.
    let id = sqlx::query_scalar!("SELECT id FROM plans ORDER BY rowid DESC LIMIT 1")
        .fetch_optional(connection)
        .await?;
    Ok(id.map(PlanId::from))
}

pub(crate) async fn bookings_of(
    connection: &mut SqliteConnection,
    plan: PlanId,
    job: JobId,
) -> Result<Vec<Booking>> {
    Ok(sqlx::query_as!(
        Booking,
        r#"SELECT id, plan_id, job_id, frame, part, parts, node_id, start_at AS start, end_at AS "end" FROM bookings
           WHERE plan_id = ? AND job_id = ?"#,
        plan.0,
        job.0
    )
    .fetch_all(connection)
    .await?)
}
