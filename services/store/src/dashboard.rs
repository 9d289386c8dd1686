//! The farm at one instant.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use forelight_protocol::{
    Booking, Budget, Dashboard, DashboardCounts, DashboardJob, DashboardNode, FarmVersions, JobState, Money,
    MoneyQuantiles, Night, Node, NodeCounts, NodeState, PowerState, ProjectSpending, TaskCounts, Timestamp,
    TrackRecord, WorkerVersion,
};
use sqlx::SqliteConnection;

use crate::budgets::{self, ledger};
use crate::columns::{Json, Word};
use crate::database::Store;
use crate::error::Result;
use crate::events;
use crate::jobs::listing::{self, JobFilter, JobOrder};
use crate::jobs::{self, JobRow, outlooks, progress};
use crate::nodes::listing::{activity, without_capabilities};
use crate::nodes::unattended::{Unattended, unattended};
use crate::plans::reading::newest;
use crate::policy::availability::{as_it_is, silent_after};
use crate::policy::projection::{JobEnds, Projected, Projection, rounded_up};

/// Most rows of each kind that the dashboard shows.
const JOBS: u32 = 200;
const NODES: usize = 200;
const BOOKINGS: usize = 100;
const EVENTS: u32 = 20;

impl Store {
    /// Everything that a dashboard shows first, read in one transaction. A node is alive if it was heard of
    /// within the last three lease times. `projection` is the expected course of the open bookings, `record` the
    /// totals of the track record. The jobs and their counts are those of `projects`, if they are given.
    pub async fn dashboard(
        &self,
        (projection, record): (&Projection, &TrackRecord),
        projects: Option<Vec<String>>,
        ttl: Duration,
        now: Timestamp,
    ) -> Result<Dashboard> {
        let mut transaction = self.read().await?;
        let connection = &mut *transaction;
        let ends = projection.ends();
        let unattended = unattended(connection, ttl, now).await?;
        let silent_since = now.plus_micros(-silent_after(ttl));
        let counts = counts(connection, projects.as_deref(), silent_since).await?;
        let (nodes, node_counts) = dashboard_nodes(connection, ttl, now).await?;
        let spread = outlooks::of_farm(connection).await?;
        Ok(Dashboard {
            at: now,
            last_event_id: events::last_id(connection).await?,
            versions: versions(connection).await?,
            jobs: dashboard_jobs(connection, projects, (&ends, &unattended), now).await?,
            jobs_open_total: counts.jobs_active,
            finish: ends.last().map(|end| spread.unwrap_or_default().around(end, now)),
            spending: spending(connection, now).await?,
            counts,
            nodes,
            node_counts,
            bookings: next_bookings(projection, now),
            events: events::newest(connection, EVENTS).await?,
            track_frames: record.frames,
            track_work_hits: record.work_hits,
            track_work_error: record.work_mean_absolute_error,
        })
    }

    /// The farm's counts; those of jobs and tasks in `projects` alone, if they are given.
    pub async fn counts(
        &self,
        projects: Option<&[String]>,
        ttl: Duration,
        now: Timestamp,
    ) -> Result<DashboardCounts> {
        let silent_since = now.plus_micros(-silent_after(ttl));
        counts(&mut *self.read().await?, projects, silent_since).await
    }
}

/// The first bookings that wait, with the times that are expected of them.
fn next_bookings(projection: &Projection, now: Timestamp) -> Vec<Booking> {
    let waiting = projection.frames.iter().filter(|frame| !frame.under_way);
    let booking = |frame: &Projected| {
        let (start, end) = (rounded_up(frame.start, now), rounded_up(frame.end, now));
        Booking { start, end, ..frame.booking.clone() }
    };
    waiting.take(BOOKINGS).map(booking).collect()
}

/// How many jobs or tasks there are in each state. Without projects, an index alone answers that.
macro_rules! by_state {
    ($row:ident, $connection:expr, $projects:expr, $all:literal, $some:literal) => {
        match $projects {
            None => sqlx::query_as!($row, $all).fetch_all(&mut *$connection).await?,
            Some(projects) => {
                sqlx::query_as!($row, $some, Json(projects)).fetch_all(&mut *$connection).await?
            }
        }
    };
}

struct JobsInState {
    state: Word<JobState>,
    number: u64,
}

struct TasksInState {
    state: String,
    number: u64,
}

async fn counts(
    connection: &mut SqliteConnection,
    projects: Option<&[String]>,
    silent_since: Timestamp,
) -> Result<DashboardCounts> {
    let mut counts = DashboardCounts::default();
    let jobs = by_state!(
        JobsInState,
        connection,
        projects,
        r#"SELECT state AS "state!: Word<JobState>", count(*) AS "number!: u64" FROM jobs GROUP BY state"#,
        r#"SELECT state AS "state!: Word<JobState>", count(*) AS "number!: u64" FROM jobs
           WHERE project IN (SELECT value FROM json_each(?)) GROUP BY state"#
    );
    for JobsInState { state: Word(state), number } in jobs {
        *counts.jobs.of(state) = number;
        if !state.is_final() {
            counts.jobs_active += number;
        }
    }
    counts.promises_at_risk = promises_at_risk(connection, projects).await?;
    counts.jobs_done = counts.jobs.done;
    counts.jobs_failed = counts.jobs.failed;
    counts.jobs_cancelled = counts.jobs.cancelled;
    let tasks = by_state!(
        TasksInState,
        connection,
        projects,
        r#"SELECT state, count(*) AS "number!: u64" FROM tasks GROUP BY state"#,
        r#"SELECT state, count(*) AS "number!: u64" FROM tasks WHERE job_id IN
           (SELECT id FROM jobs WHERE project IN (SELECT value FROM json_each(?))) GROUP BY state"#
    );
    for TasksInState { state, number } in tasks {
        let TaskCounts { waiting, ready, leased, done, failed, cancelled } = &mut counts.tasks;
        match state.as_str() {
            "waiting" => *waiting = number,
            "ready" => *ready = number,
            "leased" => *leased = number,
            "done" => *done = number,
            "failed" => *failed = number,
            _ => *cancelled = number,
        }
    }
    let row = sqlx::query!(
        r#"SELECT count(*) AS "nodes!: u64",
                  coalesce(sum(last_seen_at >= ? AND NOT drain AND set_aside IS NULL), 0)
                  AS "alive!: u64" FROM nodes WHERE removed_at IS NULL"#,
        silent_since.micros()
    )
    .fetch_one(connection)
    .await?;
    counts.nodes = row.nodes;
    counts.nodes_alive = row.alive;
    Ok(counts)
}

async fn promises_at_risk(connection: &mut SqliteConnection, projects: Option<&[String]>) -> Result<u64> {
    Ok(sqlx::query_scalar!(
        r#"SELECT count(*) AS "number!: u64" FROM jobs INDEXED BY jobs_open
           WHERE stage IN ('previewing', 'profiling', 'booked', 'rendering') AND at_risk = 1
           AND json_extract(outlook, '$.promise.kept') = 0
           AND (?1 IS NULL OR project IN (SELECT value FROM json_each(?1)))"#,
        projects.map(Json)
    )
    .fetch_one(connection)
    .await?)
}

async fn versions(connection: &mut SqliteConnection) -> Result<FarmVersions> {
    let workers = sqlx::query_as!(
        WorkerVersion,
        r#"SELECT version, count(*) AS "nodes!: u64" FROM nodes WHERE removed_at IS NULL GROUP BY version
           ORDER BY count(*) DESC, version LIMIT 20"#
    )
    .fetch_all(&mut *connection)
    .await?;
    let service = env!("CARGO_PKG_VERSION").to_owned();
    Ok(FarmVersions { service, workers, plan_id: newest(connection).await? })
}

async fn dashboard_jobs(
    connection: &mut SqliteConnection,
    projects: Option<Vec<String>>,
    (ends, unattended): (&JobEnds, &Unattended),
    now: Timestamp,
) -> Result<Vec<DashboardJob>> {
    let open = JobFilter { open: true, projects, ..JobFilter::default() };
    let ids = listing::ids(connection, &open, (JobOrder::Risk, None), JOBS).await?;
    let mut progress = progress::of_jobs(connection, &ids).await?;
    let mut list = Vec::with_capacity(ids.len());
    for row in jobs::rows(connection, &ids).await? {
        let quoted = quoted_cost(connection, &row).await?;
        let expected = row.outlook.0.expected();
        let done = progress.remove(&row.id.into()).unwrap_or_default();
        let mut job = row.job(done)?;
        expected.tell(&mut job, ends, now);
        list.push(DashboardJob {
            id: job.id,
            name: job.name,
            project: job.project,
            state: job.state,
            hold: job.hold,
            paused: job.paused,
            frames_total: job.frames_total,
            frames_done: job.frames_done,
            frames_cancelled: job.frames_cancelled,
            progress: rounded(job.progress),
            shared_cache: job.shared_cache,
            deadline: job.deadline,
            verdict: job.verdict.as_ref().map(|verdict| verdict.verdict),
            probability: job.probability.map(rounded),
            eta: job.eta.map(|eta| rounded_up(eta, now)),
            finish: job.finish,
            waits: job.waits.or_else(|| unattended.waits(job.id)),
            promise: job.promise,
            booked_cost: job.verdict.and_then(|verdict| verdict.cost),
            budget: job.budget,
            cost: job.live.and_then(|live| live.cost).or(quoted),
        });
    }
    Ok(list)
}

/// To a ten-thousandth: more says nothing, and does not compress.
fn rounded(share: f64) -> f64 {
    (share * 1e4).round() / 1e4
}

/// The quoted cost of a job that is not booked yet.
async fn quoted_cost(connection: &mut SqliteConnection, row: &JobRow) -> Result<Option<MoneyQuantiles>> {
    if row.plan_id.is_some() || row.forecast.is_none() {
        return Ok(None);
    }
    let cost = sqlx::query_scalar!(
        r#"SELECT json_extract(forecast, '$.cost') AS "cost?: Json<MoneyQuantiles>" FROM jobs WHERE id = ?"#,
        row.id
    )
    .fetch_one(connection)
    .await?;
    Ok(cost.map(|it| it.0))
}

async fn dashboard_nodes(
    connection: &mut SqliteConnection,
    ttl: Duration,
    now: Timestamp,
) -> Result<(Vec<DashboardNode>, NodeCounts)> {
    let nodes = without_capabilities(connection).await?;
    let mut nodes: Vec<Node> = nodes.into_iter().map(|node| as_it_is(node, ttl, now)).collect();
    let mut counts = NodeCounts::default();
    for node in &nodes {
        *counts.of(node.state) += 1;
        counts.asleep +=
            u64::from(node.power.as_ref().is_some_and(|power| power.state == PowerState::Asleep));
    }
    let urgency = |state: NodeState| match state {
        NodeState::SetAside => 3,
        NodeState::Silent => 2,
        NodeState::Working | NodeState::Draining | NodeState::Pausing => 1,
        NodeState::Idle | NodeState::Paused | NodeState::Drained => 0,
    };
    nodes.sort_by(|a, b| (Reverse(urgency(a.state)), &a.name).cmp(&(Reverse(urgency(b.state)), &b.name)));
    nodes.truncate(NODES);
    let mut list = Vec::with_capacity(nodes.len());
    for node in nodes {
        let activity = activity(connection, &node).await?;
        let alive = node.last_seen_at >= now.plus_micros(-silent_after(ttl));
        list.push(DashboardNode { id: node.id, name: node.name, state: node.state, alive, activity });
    }
    Ok((list, counts))
}

/// What projects with a budget, and those that spent something tonight, spend.
async fn spending(connection: &mut SqliteConnection, now: Timestamp) -> Result<Vec<ProjectSpending>> {
    let mut by_project: BTreeMap<String, Vec<Budget>> = BTreeMap::new();
    for budget in budgets::budgets(connection, now).await? {
        by_project.entry(budget.project.clone()).or_default().push(budget);
    }
    let utc = night_of("UTC", now);
    let zones: BTreeSet<String> = by_project.values().flatten().map(|budget| budget.zone.clone()).collect();
    let mut nights: BTreeMap<String, BTreeMap<String, Money>> = BTreeMap::new();
    for zone in zones.into_iter().chain(["UTC".to_owned()]) {
        let spent = ledger::spent_by_project(connection, night_of(&zone, now), now).await?;
        nights.insert(zone, spent);
    }
    for project in nights.get("UTC").into_iter().flat_map(BTreeMap::keys) {
        by_project.entry(project.clone()).or_default();
    }
    Ok(by_project
        .into_iter()
        .map(|(project, budgets)| {
            let zone = budgets.first().map(|budget| budget.zone.as_str());
            let night_from = zone.map_or(utc, |zone| night_of(zone, now));
            let tonight = nights.get(zone.unwrap_or("UTC")).and_then(|spent| spent.get(&project).copied());
            ProjectSpending { project, night_from, tonight: tonight.unwrap_or_default(), budgets }
        })
        .collect())
}

fn night_of(zone: &str, now: Timestamp) -> Timestamp {
    Night::of(zone, now).map_or(now, |night| night.from)
}
