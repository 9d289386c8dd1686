//! Serial time of jobs: how long their frames keep a node beyond their CPU time divided by its cores.
//! [`forelight_quote::serial_time`] says what finished frames teach; this module stores it.

use std::collections::BTreeMap;

use forelight_protocol::{JobId, Node, OWN_RENDERER, RenderStats, Timestamp};
use forelight_quote::serial_time::{NodeUse, SerialTime, is_due};
use sqlx::SqliteConnection;

use crate::columns::Id;
use crate::database::{Store, Write};
use crate::error::Result;
use crate::leases::LeaseRow;
use crate::plans::replans;
use crate::writing::run;

/// Rows of other jobs that are read: each job has one or two.
const MOST_PAST: u32 = 20;

impl Store {
    /// The serial time of frames of a job that has none finished: what the last jobs of its renderer teach.
    /// `frame_cpu` is the mean CPU time of its frames on a node of speed 1, in seconds.
    pub async fn expected_serial_time(&self, renderer: Option<&str>, frame_cpu: f64) -> Result<SerialTime> {
        let mut transaction = self.read().await?;
        expected(&mut transaction, renderer, frame_cpu).await
    }
}

async fn expected(
    connection: &mut SqliteConnection,
    renderer: Option<&str>,
    frame_cpu: f64,
) -> Result<SerialTime> {
    // The job itself has no finished frames yet.
    let past = of_others(connection, renderer.unwrap_or(OWN_RENDERER), None).await?;
    Ok(SerialTime::learnt([NodeUse::default(); 2], &past, (frame_cpu * 1e6) as i64))
}

/// Keeps for a job that is booked what plans use until its own frames teach better.
pub(crate) async fn expect(
    write: &mut Write,
    job: JobId,
    renderer: Option<&str>,
    frame_cpu: f64,
) -> Result<()> {
    let serial = expected(write.connection().await?, renderer, frame_cpu).await?;
    keep(write, job, serial).await
}

async fn keep(write: &mut Write, job: JobId, serial: SerialTime) -> Result<()> {
    run!(
        write,
        "UPDATE jobs SET serial_one_core = ?, serial_many_cores = ? WHERE id = ?",
        serial.one_core,
        serial.many_cores,
        job.0
    );
    Ok(())
}

/// Learns from a frame that a lease rendered whole, and wants a plan if it changes much.
pub(crate) async fn learn(
    write: &mut Write,
    row: &LeaseRow,
    node: &Node,
    (stats, at_speed_one): (&RenderStats, f64),
    now: Timestamp,
) -> Result<()> {
    if row.is_interrupted || node.pause {
        return Ok(());
    }
    let renderer = row.renderer.as_deref().and_then(|known| known.split(' ').next()).unwrap_or(OWN_RENDERER);
    let seconds = stats.cpu_seconds - stats.reused_cpu_seconds;
    let seen = NodeUse::of_frame(seconds, at_speed_one, node.cores, now.micros_since(row.granted_at));
    let many_cores = node.cores > 1;
    let frames = sqlx::query_scalar!(
        "INSERT INTO node_use (job_id, many_cores, renderer, frames, cpu, shared, used) VALUES (?, ?, ?, 1, ?, ?, ?) \
         ON CONFLICT (job_id, many_cores) DO UPDATE SET frames = frames + 1, cpu = cpu + excluded.cpu, \
         shared = shared + excluded.shared, used = used + excluded.used RETURNING frames",
        row.job_id.0,
        many_cores,
        renderer,
        seen.cpu,
        seen.shared,
        seen.used
    )
    .fetch_one(write.connection().await?)
    .await?;
    if !is_due(frames) {
        return Ok(());
    }
    let connection = write.connection().await?;
    let past = of_others(connection, renderer, Some(row.job_id)).await?;
    let own = of_job(connection, row.job_id).await?;
    let job =
        sqlx::query!("SELECT name, serial_one_core, serial_many_cores FROM jobs WHERE id = ?", row.job_id.0)
            .fetch_one(connection)
            .await?;
    let before = SerialTime { one_core: job.serial_one_core, many_cores: job.serial_many_cores };
    let all = own[0].frames + own[1].frames;
    let found = SerialTime::learnt(own, &past, own[0].cpu.saturating_add(own[1].cpu) / all.max(1));
    if found.is_news(&before, own) {
        keep(write, row.job_id, found).await?;
        let word = if found.on(node.cores) < before.on(node.cores) { "shorter" } else { "longer" };
        let name = job.name;
        replans::want(write, &format!("frames of job {name} keep their nodes {word} than was planned"))
            .await?;
    }
    Ok(())
}

async fn of_job(connection: &mut SqliteConnection, job: JobId) -> Result<[NodeUse; 2]> {
    let rows =
        sqlx::query!("SELECT many_cores, frames, cpu, shared, used FROM node_use WHERE job_id = ?", job.0)
            .fetch_all(connection)
            .await?;
    let mut found = [NodeUse::default(); 2];
    for row in rows {
        found[usize::from(row.many_cores)] =
            NodeUse { frames: row.frames, cpu: row.cpu, shared: row.shared, used: row.used };
    }
    Ok(found)
}

/// Of the last jobs of a renderer but one.
async fn of_others(
    connection: &mut SqliteConnection,
    renderer: &str,
    own: Option<JobId>,
) -> Result<Vec<[NodeUse; 2]>> {
    let rows = sqlx::query!(
        "SELECT u.job_id AS \"job_id!: Id\", u.many_cores AS \"many_cores!: bool\", u.frames AS \"frames!\", u.cpu AS \"cpu!\", \
         u.shared AS \"shared!\", u.used AS \"used!\" FROM node_use u \
         WHERE u.renderer = ? AND u.job_id IS NOT ? \
         AND NOT EXISTS (SELECT 1 FROM left_out_jobs o WHERE o.job_id = u.job_id) \
         ORDER BY u.job_id DESC LIMIT ?",
        renderer,
        own.map(|job| job.0),
        MOST_PAST
    )
    .fetch_all(connection)
    .await?;
    let mut found: BTreeMap<JobId, [NodeUse; 2]> = BTreeMap::new();
    for row in rows {
        let pair = found.entry(row.job_id.into()).or_default();
        pair[usize::from(row.many_cores)] =
            NodeUse { frames: row.frames, cpu: row.cpu, shared: row.shared, used: row.used };
    }
    Ok(found.into_values().collect())
}
