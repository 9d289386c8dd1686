//! Reading plans.

use forelight_protocol::{Booking, JobId, JobVerdict, Plan, PlanId, PlanSummary};
use sqlx::SqliteConnection;

use crate::columns::{Id, Json, corrupt};
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::shared_cache::parts;

impl Store {
    /// The plans, newest first, after the one that `before` names, at most `limit`. If `projects` are given: the
    /// plans that book a job of these, with the number of such bookings.
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
               WHERE p.rowid < coalesce((SELECT rowid FROM plans WHERE id = ?1), 9223372036854775807)
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
            r#"SELECT j.job_id AS "job_id!: String",
                      (SELECT p.id FROM plans p WHERE p.rowid < (SELECT rowid FROM plans WHERE id = ?1)
                       AND EXISTS (SELECT 1 FROM json_each(p.verdicts) v WHERE v.value ->> 'job_id' = j.job_id)
                       ORDER BY p.rowid DESC LIMIT 1) AS "before?: Id"
               FROM (SELECT value ->> 'job_id' AS job_id FROM plans, json_each(plans.verdicts) WHERE plans.id = ?1) j"#,
            plan.0
        )
        .fetch_all(&mut *transaction)
        .await?;
        let (mut bookings, mut verdicts) = (Vec::new(), Vec::new());
        for row in rows {
            let Some(before) = row.before else { continue };
            let job: JobId = row.job_id.parse().map_err(|error| corrupt("verdicts", error))?;
            let said = sqlx::query_scalar!("SELECT verdicts FROM plans WHERE id = ?", before)
                .fetch_one(&mut *transaction)
                .await?;
            verdicts.extend(said.0.into_iter().filter(|verdict| verdict.job_id == job));
            bookings.extend(bookings_of(&mut transaction, before.into(), job).await?);
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
