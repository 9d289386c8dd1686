//! Tasks that profile frames for a quote.

use forelight_protocol::{JobId, JobState, Ladders, Timestamp};
use serde::Serialize;

use crate::database::Store;
use crate::error::Result;
use crate::events::job_state;
use crate::jobs;
use crate::shared_cache::PlannedCache;
use crate::tasks::{Common, ProfileAsked};
use crate::writing::run;

/// The version of a job's profile: tasks and results never change, they only become more.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub struct ProfileVersion {
    tasks: i64,
    results: i64,
    quoted: bool,
}

impl Store {
    /// The version of a job's profile: of its preview, its profiled frames, and the plan of a shared cache.
    pub async fn profile_version(&self, job: JobId) -> Result<ProfileVersion> {
        Ok(sqlx::query_as!(
            ProfileVersion,
            r#"SELECT count(*) AS "tasks!", count(r.task_id) AS "results!",
                      EXISTS (SELECT 1 FROM jobs WHERE id = ?1 AND forecast IS NOT NULL) AS "quoted!: bool"
               FROM tasks t LEFT JOIN results r ON r.task_id = t.id
               WHERE t.job_id = ?1 AND t.kind IN ('preview', 'profile', 'cache_plan')"#,
            job.0
        )
        .fetch_one(self.readers())
        .await?)
    }

    /// Makes the profile tasks of these frames and, if wanted, the plan of the cache that all frames could
    /// share. Does nothing unless the job is `previewing`, so it may be repeated after a crash.
    pub async fn start_profiling(
        &self,
        job: JobId,
        frames: &[u32],
        plan_cache: bool,
        now: Timestamp,
    ) -> Result<()> {
        let mut write = self.write().await?;
        let row = jobs::row(write.connection().await?, job).await?;
        if row.state.0 != JobState::Previewing {
            return Ok(());
        }
        let common = Common::of(&row);
        // The middle frame represents all frames where ladders are asked for.
        let with_ladders = match row.ladders.0 {
            Ladders::All => frames.get(frames.len() / 2),
            Ladders::Own => None,
        };
        for (turn, frame) in (0..).zip(frames) {
            let asked = ProfileAsked {
                frame: *frame,
                samples: row.samples,
                turn,
                ladders: with_ladders == Some(frame),
                cache: None,
            };
            common.profile(&mut write, asked, plan_cache).await?;
        }
        if plan_cache {
            common.cache_plan(&mut write, row.frame_set()?.iter().collect()).await?;
        }
        run!(write, "UPDATE jobs SET stage = 'profiling' WHERE id = ?", job.0);
        job_state(&mut write, job, JobState::Profiling, None, now);
        self.commit(write).await
    }

    /// Makes profile tasks of more frames, with the planned shared cache if there is one. Does nothing unless
    /// the job is `profiling` and none of the frames was asked for before, so it may be repeated after a
    /// crash.
    pub async fn profile_more(&self, job: JobId, frames: &[u32], planned: &PlannedCache) -> Result<()> {
        let mut write = self.write().await?;
        let row = jobs::row(write.connection().await?, job).await?;
        let asked: Vec<u32> = sqlx::query_scalar!(
            r#"SELECT frame AS "frame!" FROM tasks WHERE job_id = ? AND kind = 'profile'"#,
            job.0
        )
        .fetch_all(write.connection().await?)
        .await?;
        if row.state.0 != JobState::Profiling || frames.iter().any(|frame| asked.contains(frame)) {
            return Ok(());
        }
        let common = Common::of(&row);
        let cache = match planned {
            PlannedCache::There { plan, .. } => plan.cache,
            PlannedCache::NotAsked | PlannedCache::Pending => None,
        };
        for (turn, &frame) in (asked.len() as u64..).zip(frames) {
            let samples = row.samples;
            let asked = ProfileAsked { frame, samples, turn, ladders: false, cache };
            common.profile(&mut write, asked, false).await?;
        }
        self.commit(write).await
    }
}
