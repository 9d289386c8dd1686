//! Learns from finished jobs how far quotes are off, by renderer and class of features.

use forelight_forecast::{Experience, residual};
use forelight_protocol::{FrameForecast, JobId, Timestamp};

use crate::database::{Store, Write};
use crate::error::Result;
use crate::policy::learning::{ALL_FRAMES, Residuals, experience, is_learnt_from};
use crate::writing::run;
use forelight_quote::{JobForecast, QuoteBasis, QuoteKind};

/// A quote learns from this many finished jobs, the newest: renderers, scenes and machines change slowly.
const WINDOW: u32 = 200;

impl Store {
    /// The kinds of quotes with finished jobs, and the number of these jobs.
    pub async fn learnt_kinds(&self) -> Result<Vec<(QuoteKind, u64)>> {
        let rows = sqlx::query!(
            "SELECT renderer, feature_class, count(*) AS \"jobs!: u64\" FROM quotes \
             WHERE learnt_at IS NOT NULL AND job_id NOT IN (SELECT job_id FROM left_out_jobs) \
             GROUP BY 1, 2 ORDER BY 1, 2"
        )
        .fetch_all(self.readers())
        .await?;
        Ok(rows
            .into_iter()
            .map(|row| (QuoteKind { renderer: row.renderer, feature_class: row.feature_class }, row.jobs))
            .collect())
    }

    /// The experience from the newest finished jobs of this kind.
    pub async fn experience(&self, kind: &QuoteKind) -> Result<Experience> {
        let rows = sqlx::query_as!(
            Residuals,
            "SELECT s.job_id AS job, s.frame, s.work_residual AS work, s.cpu_residual AS cpu \
             FROM quote_spreads s WHERE s.job_id IN (SELECT job_id FROM quotes WHERE renderer = ? AND feature_class = ? \
             AND learnt_at IS NOT NULL AND job_id NOT IN (SELECT job_id FROM left_out_jobs) \
             ORDER BY learnt_at DESC, job_id DESC LIMIT ?) \
             AND (s.work_residual IS NOT NULL OR s.cpu_residual IS NOT NULL) ORDER BY s.job_id, s.frame",
            kind.renderer,
            kind.feature_class,
            WINDOW
        )
        .fetch_all(self.readers())
        .await?;
        Ok(experience(rows))
    }
}

/// Stores the basis of a quote inside the write that stores the quote.
pub(crate) async fn keep(
    write: &mut Write,
    job: JobId,
    forecast: &JobForecast,
    frames: &[FrameForecast],
    basis: &QuoteBasis,
) -> Result<()> {
    run!(
        write,
        "INSERT INTO quotes (job_id, renderer, feature_class) VALUES (?, ?, ?)",
        job.0,
        basis.kind.renderer,
        basis.kind.feature_class
    );
    let total = (ALL_FRAMES, forecast.total.work, forecast.total.cpu_seconds, basis.total);
    let each = frames.iter().zip(&basis.frames);
    let each = each.map(|(frame, &spreads)| (i64::from(frame.frame), frame.work, frame.cpu_seconds, spreads));
    for (frame, work, cpu, spreads) in std::iter::once(total).chain(each) {
        run!(
            write,
            "INSERT INTO quote_spreads (job_id, frame, work_mean, work_spread, cpu_mean, cpu_spread) \
             VALUES (?, ?, ?, ?, ?, ?)",
            job.0,
            frame,
            work.mean,
            spreads.work,
            cpu.mean,
            spreads.cpu
        );
    }
    Ok(())
}

/// Stores the residuals of the job's quote, inside the write that finishes the job, if it has a stored basis.
///
/// Nothing is learnt from a job without some of its frames: the quote is for all of them.
pub(crate) async fn learn(write: &mut Write, job: JobId, now: Timestamp) -> Result<()> {
    let lacks_some = sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM frames WHERE job_id = ? AND dropped = 1) AS "lacks_some!: bool""#,
        job.0
    );
    if lacks_some.fetch_one(write.connection().await?).await? {
        return Ok(());
    }
    let rows = sqlx::query!(
        r#"SELECT s.frame AS "frame!: i64", s.work_mean AS "work_mean!: f64", s.work_spread AS "work_spread!: f64",
                  s.cpu_mean AS "cpu_mean!: f64", s.cpu_spread AS "cpu_spread!: f64",
                  f.actual_work AS "actual_work!: f64", f.actual_cpu AS "actual_cpu!: f64"
           FROM quote_spreads s JOIN frames f ON f.job_id = s.job_id AND f.frame = s.frame WHERE s.job_id = ?1
           UNION ALL SELECT s.frame, s.work_mean, s.work_spread, s.cpu_mean, s.cpu_spread,
                  (SELECT sum(actual_work) FROM frames WHERE job_id = ?1),
                  (SELECT sum(actual_cpu) FROM frames WHERE job_id = ?1)
           FROM quote_spreads s WHERE s.job_id = ?1 AND s.frame = -1 ORDER BY 1"#,
        job.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    // The first row stands for all frames.
    for (place, row) in rows.iter().enumerate() {
        if !is_learnt_from(row.frame, place, rows.len()) {
            continue;
        }
        run!(
            write,
            "UPDATE quote_spreads SET work_residual = ?, cpu_residual = ? WHERE job_id = ? AND frame = ?",
            residual(row.work_mean, row.work_spread, row.actual_work),
            residual(row.cpu_mean, row.cpu_spread, row.actual_cpu),
            job.0,
            row.frame
        );
    }
    run!(write, "UPDATE quotes SET learnt_at = ? WHERE job_id = ?", now.micros(), job.0);
    Ok(())
}
