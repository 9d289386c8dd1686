//! Nodes.

pub(crate) mod changing;
pub(crate) mod joining;
pub(crate) mod learning;
pub(crate) mod listing;
pub(crate) mod removing;
pub(crate) mod unattended;

use std::collections::BTreeMap;

use forelight_forecast::learned_factor;
use forelight_protocol::{Capabilities, Money, Node, NodeCalendar, NodeId, NodeTerms, Timestamp};
use sqlx::{FromRow, SqliteConnection};

use crate::columns::{Id, Json, Time, hex_list};
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::policy::availability::{Opening, opening, silence};
use crate::policy::nodes::{Switches, state};

/// Plans count a node as lost if it was silent for this long while it should have been awake: five minutes,
/// in microseconds. That is longer than a worker takes to restart, and much shorter than a night.
pub const LOST: i64 = 300_000_000;

/// A node's row, with its current task.
#[derive(FromRow)]
pub(crate) struct NodeRow {
    id: Id,
    name: String,
    speed: f64,
    speed_set: Option<f64>,
    price_per_hour: i64,
    price_set: Option<i64>,
    cores: u32,
    drain: bool,
    pause: bool,
    paused: bool,
    set_aside: Option<String>,
    idle_reason: Option<String>,
    capabilities: Json<Capabilities>,
    learned_millionths: i64,
    learned_jobs: u64,
    schedule: Option<Json<NodeCalendar>>,
    schedule_set: Option<Json<NodeCalendar>>,
    terms: Json<NodeTerms>,
    created_at: Time,
    last_seen_at: Time,
    task_id: Option<Id>,
}

/// Rows of nodes: `node_rows!("WHERE n.id = ?", node.0)`. With `brief` first, without what their machines can
/// do, which is by far the most of them.
macro_rules! node_rows {
    (brief, $rest:literal $(, $value:expr)* $(,)?) => {
        $crate::nodes::node_rows!(@ "'{}'" $rest $(, $value)*)
    };
    ($rest:literal $(, $value:expr)* $(,)?) => {
        $crate::nodes::node_rows!(@ "n.capabilities" $rest $(, $value)*)
    };
    (@ $capabilities:literal $rest:literal $(, $value:expr)*) => {
        sqlx::query_as!(
            $crate::nodes::NodeRow,
            "SELECT n.id, n.name, n.speed, n.speed_set, n.price_per_hour, n.price_set, n.cores, n.drain, \
             n.pause, n.paused, n.set_aside, n.idle_reason, "
                + $capabilities + " AS \"capabilities!: crate::columns::Json<forelight_protocol::Capabilities>\", \
             n.learned_millionths, n.learned_jobs, n.schedule, n.schedule_set, n.terms, n.created_at, n.last_seen_at, \
             (SELECT l.task_id FROM leases l WHERE l.node_id = n.id AND l.state = 'active' \
              ORDER BY l.granted_at DESC, l.id LIMIT 1) AS \"task_id?: crate::columns::Id\" FROM nodes n "
                + $rest
            $(, $value)*
        )
    };
}
pub(crate) use node_rows;

impl Store {
    /// Refuses a worker process whose node was taken over by another process.
    pub async fn check_worker(&self, node: NodeId, worker: uuid::Uuid) -> Result<()> {
        let mut connection = self.readers().acquire().await?;
        if !has_another_worker(&mut connection, node, worker).await? {
            return Ok(());
        }
        let Node { name, .. } = read(&mut connection, node).await?;
        Err(StoreError::Conflict(format!(
            "another worker has registered as {name:?} and taken the node over; to run both, \
             give each its own name"
        )))
    }

    /// A node.
    pub async fn node(&self, node: NodeId) -> Result<Node> {
        let mut connection = self.readers().acquire().await?;
        let node = read(&mut connection, node).await?;
        Ok(Node { activity: listing::activity(&mut connection, &node).await?, ..node })
    }

    /// The name of a node, which may have been removed.
    pub async fn node_name(&self, node: NodeId) -> Result<String> {
        let name = sqlx::query_scalar!("SELECT name FROM nodes WHERE id = ?", node.0);
        name.fetch_optional(self.readers()).await?.ok_or(StoreError::NotFound("node"))
    }

    /// The nodes after `after`, oldest first, at most `limit`.
    pub async fn nodes(&self, after: Option<NodeId>, limit: u32) -> Result<Vec<Node>> {
        list(&mut *self.readers().acquire().await?, after, limit).await
    }
}

/// Whether another process registered the node last.
pub(crate) async fn has_another_worker(
    connection: &mut SqliteConnection,
    node: NodeId,
    worker: uuid::Uuid,
) -> Result<bool> {
    sqlx::query_scalar!(
        r#"SELECT coalesce(worker <> ?, 0) AS "is_another!: bool" FROM nodes
           WHERE id = ? AND removed_at IS NULL"#,
        worker,
        node.0
    )
    .fetch_optional(connection)
    .await?
    .ok_or(StoreError::NotFound("node"))
}

pub(crate) async fn read(connection: &mut SqliteConnection, node: NodeId) -> Result<Node> {
    let row =
        node_rows!("WHERE n.id = ? AND n.removed_at IS NULL", node.0).fetch_optional(connection).await?;
    Ok(row.ok_or(StoreError::NotFound("node"))?.into())
}

/// A node that may have been removed, but is still booked, holds a task or has measured something.
pub(crate) async fn read_any(connection: &mut SqliteConnection, node: NodeId) -> Result<Node> {
    let row = node_rows!("WHERE n.id = ?", node.0).fetch_one(connection).await?;
    Ok(row.into())
}

/// The nodes with these ids, as [`read_any`] reads one.
pub(crate) async fn by_ids(
    connection: &mut SqliteConnection,
    ids: impl IntoIterator<Item = NodeId>,
) -> Result<BTreeMap<NodeId, Node>> {
    let ids = hex_list(ids.into_iter().map(|id| id.0));
    if ids.0.is_empty() {
        return Ok(BTreeMap::new());
    }
    let rows = node_rows!("WHERE n.id IN (SELECT unhex(value) FROM json_each(?))", ids)
        .fetch_all(connection)
        .await?;
    Ok(rows.into_iter().map(|row| (row.id.into(), row.into())).collect())
}

pub(crate) async fn by_name(connection: &mut SqliteConnection, name: &str) -> Result<Option<Node>> {
    let row =
        node_rows!("WHERE n.name = ? AND n.removed_at IS NULL", name).fetch_optional(connection).await?;
    Ok(row.map(Node::from))
}

/// The nodes with waiting booked frames that get no tasks or are lost, counted from the start of the service.
pub(crate) async fn gone(
    connection: &mut SqliteConnection,
    up_since: Timestamp,
    now: Timestamp,
) -> Result<Vec<NodeId>> {
    let rows = node_rows!(
        "WHERE (drain OR pause OR set_aside IS NOT NULL OR n.last_seen_at < ?) AND EXISTS (SELECT 1 \
         FROM tasks t INDEXED BY tasks_ready_booked WHERE t.state = 'ready' AND t.held = 0 \
         AND t.kind IN ('cache_fill', 'render_part', 'render') AND t.booked_node = n.id) ORDER BY n.id",
        now.plus_micros(-LOST).micros()
    )
    .fetch_all(connection)
    .await?;
    let mut gone = Vec::new();
    for row in rows {
        let node = Node::from(row);
        let heard = Node { last_seen_at: node.last_seen_at.max(up_since), ..node };
        if !heard.takes_tasks() || silence(&heard, now) > LOST {
            gone.push(heard.id);
        }
    }
    Ok(gone)
}

/// A node with an unknown wake-up time asks again after a day.
const ASLEEP_FOR_LONG: i64 = 24 * 3_600_000_000;

/// When a node wakes up; `None` if it is awake. Every heartbeat asks, so nodes without a calendar are not
/// read.
pub(crate) async fn sleep_of(
    connection: &mut SqliteConnection,
    node: NodeId,
    has_calendar: bool,
    now: Timestamp,
) -> Result<Option<Timestamp>> {
    if !has_calendar {
        return Ok(None);
    }
    Ok(match opening(&read_any(connection, node).await?, now) {
        Opening::Awake(_) => None,
        Opening::Asleep(until) => Some(until.unwrap_or(now.plus_micros(ASLEEP_FOR_LONG))),
    })
}

pub(crate) async fn list(
    connection: &mut SqliteConnection,
    after: Option<NodeId>,
    limit: u32,
) -> Result<Vec<Node>> {
    let after = after.map_or(uuid::Uuid::nil(), |node| node.0);
    let rows = node_rows!("WHERE n.id > ? AND n.removed_at IS NULL ORDER BY n.id LIMIT ?", after, limit)
        .fetch_all(connection)
        .await?;
    Ok(rows.into_iter().map(Node::from).collect())
}

impl From<NodeRow> for Node {
    fn from(row: NodeRow) -> Self {
        let task_id = row.task_id.map(Into::into);
        let switches = Switches {
            drain: row.drain,
            pause: row.pause,
            paused: row.paused,
            is_set_aside: row.set_aside.is_some(),
        };
        Node {
            id: row.id.into(),
            name: row.name,
            speed: row.speed_set.unwrap_or(row.speed),
            speed_set: row.speed_set.is_some(),
            price_per_hour: Money(row.price_set.unwrap_or(row.price_per_hour)),
            price_set: row.price_set.is_some(),
            time_factor: learned_factor(row.learned_millionths, row.learned_jobs),
            cores: row.cores,
            capabilities: row.capabilities.0,
            schedule_set: row.schedule_set.is_some(),
            schedule: row.schedule_set.or(row.schedule).map(|it| it.0),
            terms: row.terms.0,
            power: None,
            state: state(switches, task_id),
            drain: row.drain,
            pause: row.pause,
            set_aside: row.set_aside,
            idle_reason: row.idle_reason,
            task_id,
            activity: None,
            created_at: row.created_at.into(),
            last_seen_at: row.last_seen_at.into(),
        }
    }
}
