//! Quotes that wait because no node takes tasks, or because the budget of their project is used up.
//!
//! Plans say why a booked job waits, but a job has no plan before it is quoted. Without this, a user who
//! forgot to start a worker would wait without an explanation.

use std::collections::BTreeMap;
use std::time::Duration;

use forelight_protocol::{Job, JobId, Needs, Node, Timestamp, Waits};
use sqlx::SqliteConnection;

use crate::database::Store;
use crate::error::Result;
use crate::nodes;
use crate::policy::availability::{as_it_is, silent_after};
use crate::policy::unattended::why_nobody_works;

/// The quotes that no node works on or will start, as things stand, and why.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Unattended {
    jobs: BTreeMap<JobId, Waits>,
}

impl Unattended {
    /// Why the job waits, if this is the reason.
    pub fn waits(&self, job: JobId) -> Option<Waits> {
        self.jobs.get(&job).cloned()
    }

    /// Fills the reason in where a job has none.
    pub fn tell<'a>(&self, jobs: impl IntoIterator<Item = &'a mut Job>) {
        for job in jobs {
            job.waits = job.waits.take().or_else(|| self.waits(job.id));
        }
    }
}

impl Store {
    /// The quotes that nothing is done for, and why. A node is silent after three lease times.
    pub async fn unattended(&self, ttl: Duration, now: Timestamp) -> Result<Unattended> {
        unattended(&mut *self.read().await?, ttl, now).await
    }
}

pub(crate) async fn unattended(
    connection: &mut SqliteConnection,
    ttl: Duration,
    now: Timestamp,
) -> Result<Unattended> {
    let jobs = sqlx::query!(
        r#"SELECT j.id, j.project, j.paused, j.renderer, j.rendered_by, j.denoise,
                  EXISTS (SELECT 1 FROM tasks t WHERE t.job_id = j.id AND t.held = 1) AS "is_held!: bool"
           FROM jobs j WHERE j.state IN ('previewing', 'profiling')
           AND NOT EXISTS (SELECT 1 FROM tasks t WHERE t.job_id = j.id AND t.state = 'leased')"#
    )
    .fetch_all(&mut *connection)
    .await?;
    let (held, jobs): (Vec<_>, Vec<_>) = jobs.into_iter().partition(|job| job.is_held);
    let held = held.into_iter().map(|job| (JobId::from(job.id), Waits::of_held(job.paused, &job.project)));
    let needs_own = jobs.iter().all(|job| job.renderer.is_none() && !job.denoise);
    if jobs.is_empty() || needs_own && somebody_is_there(connection, ttl, now).await? {
        return Ok(Unattended { jobs: held.collect() });
    }
    let nodes = nodes::list(connection, None, u32::MAX).await?;
    let nodes: Vec<Node> = nodes.into_iter().map(|node| as_it_is(node, ttl, now)).collect();
    let jobs = jobs.into_iter().filter_map(|job| {
        let (renderer, by) = (job.renderer.map(|it| it.0), job.rendered_by.map(|it| it.0));
        let needs = Needs::of(renderer.as_ref(), by.as_ref(), job.denoise);
        Some((JobId::from(job.id), why_nobody_works(&nodes, needs.as_ref())?))
    });
    Ok(Unattended { jobs: held.chain(jobs).collect() })
}

/// Whether some node certainly takes tasks. Ignores nodes with calendars; this is enough on most farms.
async fn somebody_is_there(connection: &mut SqliteConnection, ttl: Duration, now: Timestamp) -> Result<bool> {
    Ok(sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM nodes WHERE NOT (drain OR pause OR set_aside IS NOT NULL) AND removed_at IS NULL
                  AND last_seen_at >= ? AND coalesce(schedule_set, schedule) IS NULL
                          AND coalesce(json_array_length(terms, '$.maintenance'), 0) = 0) AS "is_there!: bool""#,
        now.plus_micros(-silent_after(ttl)).micros()
    )
    .fetch_one(connection)
    .await?)
}
