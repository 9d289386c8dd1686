//! Nodes.

pub(crate) mod changing;
pub(crate) mod joining;
pub(crate) mod learning;
pub(crate) mod unattended;

use forelight_forecast::learned_factor;
use forelight_protocol::{Money, Node, NodeCalendar, NodeId, TaskId, Timestamp};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::decode::{id, id_opt, json, json_opt, time, whole};
use crate::error::StoreError;
use crate::policy::availability::{Opening, opening, silence};
use crate::policy::nodes::{Switches, state};

/// A node that was not heard of for this long while it should have been awake is lost to plans: five minutes, in microseconds. Longer than a
/// worker takes to be started again, and much shorter than a night.
pub const LOST: i64 = 300_000_000;

/// Nodes, with what they work on and what else is asked of each.
macro_rules! select_nodes {
    ($rest:expr) => {
        $crate::nodes::select_nodes!("", $rest)
    };
    ($more:expr, $rest:expr) => {
        concat!(
            "SELECT n.*, (SELECT l.task_id FROM leases l WHERE l.node_id = n.id AND l.state = 'active' ",
            "ORDER BY l.granted_at DESC, l.id LIMIT 1) AS task_id",
            $more,
            " FROM nodes n ",
            $rest
        )
    };
}
pub(crate) use select_nodes;

/// Whether a node is to get no tasks, as [`Node::takes_tasks`] says.
macro_rules! closed {
    () => {
        "(drain OR pause OR set_aside IS NOT NULL)"
    };
}
pub(crate) use closed;

/// Whether there is anything by which a node, `n`, might sleep.
macro_rules! has_calendar {
    () => {
        "(coalesce(n.schedule_set, n.schedule) IS NOT NULL OR n.terms <> '{}') AS has_calendar"
    };
}
pub(crate) use has_calendar;

impl Store {
    /// Refuses a process whose node was taken over by another.
    pub async fn check_worker(&self, node: NodeId, worker: uuid::Uuid) -> Result<(), StoreError> {
        let mut connection = self.readers().acquire().await?;
        if !has_another_worker(&mut connection, node, worker).await? {
            return Ok(());
        }
        let Node { name, .. } = read(&mut connection, node).await?;
        Err(StoreError::Conflict(format!(
            "another worker has registered as {name:?} since, and has taken the node over; if both are to work, give each a name of its own"
        )))
    }

    /// A node.
    pub async fn node(&self, node: NodeId) -> Result<Node, StoreError> {
        let mut connection = self.readers().acquire().await?;
        read(&mut connection, node).await
    }

    /// The nodes after `after`, oldest first, at most `limit`.
    pub async fn nodes(&self, after: Option<NodeId>, limit: u32) -> Result<Vec<Node>, StoreError> {
        let mut connection = self.readers().acquire().await?;
        list(&mut connection, after, limit).await
    }
}

/// Whether the node was registered last by another process than this one.
pub(crate) async fn has_another_worker(
    connection: &mut SqliteConnection,
    node: NodeId,
    worker: uuid::Uuid,
) -> Result<bool, StoreError> {
    let found: Option<bool> = sqlx::query_scalar("SELECT coalesce(worker <> ?, 0) FROM nodes WHERE id = ?")
        .bind(worker)
        .bind(node.0)
        .fetch_optional(connection)
        .await?;
    found.ok_or(StoreError::NotFound("node"))
}

pub(crate) async fn read(connection: &mut SqliteConnection, node: NodeId) -> Result<Node, StoreError> {
    let row = sqlx::query(select_nodes!("WHERE n.id = ?")).bind(node.0).fetch_optional(connection).await?;
    decode(&row.ok_or(StoreError::NotFound("node"))?)
}

pub(crate) async fn by_name(
    connection: &mut SqliteConnection,
    name: &str,
) -> Result<Option<Node>, StoreError> {
    let row = sqlx::query(select_nodes!("WHERE n.name = ?")).bind(name).fetch_optional(connection).await?;
    row.as_ref().map(decode).transpose()
}

/// The nodes that have frames booked that wait, and get no tasks, or were not heard of for too long since the service is up.
pub(crate) async fn gone(
    connection: &mut SqliteConnection,
    up_since: Timestamp,
    now: Timestamp,
) -> Result<Vec<NodeId>, StoreError> {
    let rows = sqlx::query(select_nodes!(concat!(
        "WHERE (",
        closed!(),
        " OR n.last_seen_at < ?) AND EXISTS (SELECT 1 FROM tasks t INDEXED BY tasks_ready_booked \
         WHERE t.state = 'ready' AND t.kind IN ('cache_fill', 'render') AND t.booked_node = n.id) ORDER BY n.id"
    )))
    .bind(now.plus_micros(-LOST).micros())
    .fetch_all(connection)
    .await?;
    let mut gone = Vec::new();
    for row in &rows {
        let node = decode(row)?;
        let heard = Node { last_seen_at: node.last_seen_at.max(up_since), ..node };
        if !heard.takes_tasks() || silence(&heard, now) > LOST {
            gone.push(heard.id);
        }
    }
    Ok(gone)
}

/// A node of which nobody knows when it wakes up asks again after a day.
const ASLEEP_FOR_LONG: i64 = 24 * 3_600_000_000;

/// Until when a node sleeps. One without a calendar, as most are, is not read for it: every heartbeat asks.
pub(crate) async fn sleep_of(
    connection: &mut SqliteConnection,
    node: NodeId,
    has_calendar: bool,
    now: Timestamp,
) -> Result<Option<Timestamp>, StoreError> {
    if !has_calendar {
        return Ok(None);
    }
    Ok(match opening(&read(connection, node).await?, now) {
        Opening::Awake(_) => None,
        Opening::Asleep(until) => Some(until.unwrap_or(now.plus_micros(ASLEEP_FOR_LONG))),
    })
}

pub(crate) async fn list(
    connection: &mut SqliteConnection,
    after: Option<NodeId>,
    limit: u32,
) -> Result<Vec<Node>, StoreError> {
    let rows = sqlx::query(select_nodes!("WHERE n.id > ? ORDER BY n.id LIMIT ?"))
        .bind(after.map_or(uuid::Uuid::nil(), |node| node.0))
        .bind(limit)
        .fetch_all(connection)
        .await?;
    rows.iter().map(decode).collect()
}

pub(crate) fn decode(row: &SqliteRow) -> Result<Node, StoreError> {
    let speed_set: Option<f64> = row.try_get("speed_set")?;
    let price_set: Option<i64> = row.try_get("price_set")?;
    let task_id = id_opt(row, "task_id")?.map(TaskId);
    let schedule_set: Option<NodeCalendar> = json_opt(row, "schedule_set")?;
    let (drain, pause, paused): (bool, bool, bool) =
        (row.try_get("drain")?, row.try_get("pause")?, row.try_get("paused")?);
    let set_aside: Option<String> = row.try_get("set_aside")?;
    let switches = Switches { drain, pause, paused, is_set_aside: set_aside.is_some() };
    Ok(Node {
        id: NodeId(id(row, "id")?),
        name: row.try_get("name")?,
        speed: speed_set.map_or_else(|| row.try_get("speed"), Ok)?,
        speed_set: speed_set.is_some(),
        price_per_hour: Money(price_set.map_or_else(|| row.try_get("price_per_hour"), Ok)?),
        price_set: price_set.is_some(),
        time_factor: learned_factor(row.try_get("learned_millionths")?, whole(row, "learned_jobs")?),
        cores: whole(row, "cores")?,
        capabilities: json(row, "capabilities")?,
        schedule_set: schedule_set.is_some(),
        schedule: schedule_set.map_or_else(|| json_opt(row, "schedule"), |set| Ok(Some(set)))?,
        terms: json(row, "terms")?,
        power: None,
        state: state(switches, task_id),
        drain,
        pause,
        set_aside,
        idle_reason: row.try_get("idle_reason")?,
        task_id,
        created_at: time(row, "created_at")?,
        last_seen_at: time(row, "last_seen_at")?,
    })
}
