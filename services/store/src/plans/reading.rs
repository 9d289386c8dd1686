//! Plans, as they are read.

use forelight_protocol::{Booking, JobId, JobVerdict, Plan, PlanId, PlanSummary};
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::decode::{corrupt, id, id_opt, json, time, whole, word};
use crate::error::StoreError;
use crate::plans::bookings::decode_booking;
use crate::shared_cache::parts;

impl Store {
    /// The plans, newest first, after the one that `before` names, at most `limit`.
    pub async fn plans(&self, before: Option<PlanId>, limit: u32) -> Result<Vec<PlanSummary>, StoreError> {
        let rows = sqlx::query(
            "SELECT p.*, (SELECT count(*) FROM bookings b WHERE b.plan_id = p.id) AS bookings FROM plans p \
             WHERE p.rowid < coalesce((SELECT rowid FROM plans WHERE id = ?1), 9223372036854775807) ORDER BY p.rowid DESC LIMIT ?2",
        )
        .bind(before.map(|plan| plan.0))
        .bind(limit)
        .fetch_all(self.readers())
        .await?;
        rows.iter()
            .map(|row| {
                Ok(PlanSummary {
                    id: PlanId(id(row, "id")?),
                    parent_id: id_opt(row, "parent_id")?.map(PlanId),
                    reason: word(row, "reason")?,
                    causes: json(row, "causes")?,
                    created_at: time(row, "created_at")?,
                    bookings: whole(row, "bookings")?,
                })
            })
            .collect()
    }

    /// What the plans before this one booked last for each of its jobs, and said of it.
    pub async fn booked_before(&self, plan: PlanId) -> Result<(Vec<Booking>, Vec<JobVerdict>), StoreError> {
        let mut transaction = self.read().await?;
        let rows = sqlx::query(
            "SELECT j.job_id, (SELECT p.id FROM plans p WHERE p.rowid < (SELECT rowid FROM plans WHERE id = ?1) \
             AND EXISTS (SELECT 1 FROM json_each(p.verdicts) v WHERE v.value ->> 'job_id' = j.job_id) \
             ORDER BY p.rowid DESC LIMIT 1) AS before FROM (SELECT value ->> 'job_id' AS job_id FROM plans, json_each(plans.verdicts) WHERE plans.id = ?1) j",
        )
        .bind(plan.0)
        .fetch_all(&mut *transaction)
        .await?;
        let (mut bookings, mut verdicts) = (Vec::new(), Vec::new());
        for row in &rows {
            let Some(before) = id_opt(row, "before")? else { continue };
            let job: JobId =
                row.try_get::<&str, _>("job_id")?.parse().map_err(|error| corrupt("verdicts", error))?;
            let said = sqlx::query("SELECT verdicts FROM plans WHERE id = ?")
                .bind(before)
                .fetch_one(&mut *transaction)
                .await?;
            let said: Vec<JobVerdict> = json(&said, "verdicts")?;
            verdicts.extend(said.into_iter().filter(|verdict| verdict.job_id == job));
            let rows = sqlx::query("SELECT * FROM bookings WHERE plan_id = ? AND job_id = ?")
                .bind(before)
                .bind(job.0)
                .fetch_all(&mut *transaction)
                .await?;
            for row in &rows {
                bookings.push(decode_booking(row)?);
            }
        }
        Ok((bookings, verdicts))
    }

    /// The newest plan; `None` before the first.
    pub async fn newest_plan(&self) -> Result<Option<PlanId>, StoreError> {
        let mut connection = self.readers().acquire().await?;
        newest(&mut connection).await
    }

    /// A plan.
    pub async fn plan(&self, plan: PlanId) -> Result<Plan, StoreError> {
        let mut transaction = self.read().await?;
        let row = sqlx::query("SELECT * FROM plans WHERE id = ?")
            .bind(plan.0)
            .fetch_optional(&mut *transaction)
            .await?;
        let row = row.ok_or(StoreError::NotFound("plan"))?;
        let bookings = sqlx::query("SELECT * FROM bookings WHERE plan_id = ? ORDER BY start_at, id")
            .bind(plan.0)
            .fetch_all(&mut *transaction)
            .await?;
        let cache_parts = parts::of_plan(&mut transaction, plan.0).await?;
        Ok(Plan {
            id: plan,
            parent_id: id_opt(&row, "parent_id")?.map(PlanId),
            reason: word(&row, "reason")?,
            causes: json(&row, "causes")?,
            created_at: time(&row, "created_at")?,
            verdicts: json(&row, "verdicts")?,
            bookings: bookings.iter().map(decode_booking).collect::<Result<_, _>>()?,
            seeds: cache_parts,
        })
    }
}

pub(crate) async fn newest(connection: &mut SqliteConnection) -> Result<Option<PlanId>, StoreError> {
    // By row number, not by id: ids sort by the clock, and the clock may have been set back.
    let id = sqlx::query_scalar("SELECT id FROM plans ORDER BY rowid DESC LIMIT 1")
        .fetch_optional(connection)
        .await?;
    Ok(id.map(PlanId))
}
