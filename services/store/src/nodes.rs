//! Nodes.

use forelight_forecast::learned_factor;
use forelight_protocol::{
    Event, EventKind, Money, Node, NodeCalendar, NodeChange, NodeId, NodeRegistration, TaskId, Timestamp,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Write;
use crate::decode::{id, id_opt, json, json_opt, time, to_json, whole};
use crate::events::{append, event};
use crate::idempotency::{Answered, IdempotencyKey, earlier_answer, record};
use crate::policy::availability::{Opening, opening, silence, with_power};
use crate::policy::nodes::{Switches, cause_of, is_same_machine, may_take_tasks_again, state};
use crate::{Store, StoreError, leases, replans};

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

impl Store {
    /// Registers a node. One of the same name is updated and keeps its id: a worker that starts again is the same node.
    /// A speed or price that was set by hand stays in force.
    pub async fn register_node(
        &self,
        registration: &NodeRegistration,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Answered<Node>, StoreError> {
        let mut write = self.write().await?;
        if let Some(answer) = earlier_answer(&mut write, key).await? {
            return Ok(Answered::Repeated(answer));
        }
        let node = upsert(&mut write, registration, now).await?;
        record(&mut write, key, 201, &node, now)?;
        self.commit(write).await?;
        Ok(Answered::Fresh(node))
    }

    /// Changes a node. A speed or price that is set here stays in force until it is set again, or given up with `None`
    /// inside `Some`: then what the node said of itself last holds.
    pub async fn change_node(
        &self,
        node: NodeId,
        change: &NodeChange,
        now: Timestamp,
    ) -> Result<Node, StoreError> {
        let mut write = self.write().await?;
        sqlx::query(
            "UPDATE nodes SET drain = coalesce(?1, drain), pause = coalesce(?2, pause), \
             speed_set = CASE WHEN ?3 THEN ?4 ELSE speed_set END, price_set = CASE WHEN ?5 THEN ?6 ELSE price_set END, \
             set_aside = CASE ?7 WHEN 1 THEN coalesce(set_aside, 'by hand') WHEN 0 THEN NULL ELSE set_aside END, \
             trusted_since = CASE ?7 WHEN 0 THEN ?8 ELSE trusted_since END, \
             schedule_set = CASE WHEN ?10 THEN ?11 ELSE schedule_set END, terms = coalesce(?12, terms) WHERE id = ?9",
        )
        .bind(change.drain)
        .bind(change.pause)
        .bind(change.speed.is_some())
        .bind(change.speed.flatten())
        .bind(change.price_per_hour.is_some())
        .bind(change.price_per_hour.flatten().map(Money::micro_units))
        .bind(change.set_aside)
        .bind(now.micros())
        .bind(node.0)
        .bind(change.schedule.is_some())
        .bind(change.schedule.as_ref().and_then(Option::as_ref).map(to_json).transpose()?)
        .bind(change.terms.as_ref().map(to_json).transpose()?)
        .execute(write.connection().await?)
        .await?;
        if change.cancel_task == Some(true) {
            take_tasks_away(&mut write, node, now).await?;
        }
        let changed = read(write.connection().await?, node).await?;
        append(
            &mut write,
            Event {
                node_id: Some(node),
                message: Some(changed.name.clone()),
                ..event(EventKind::NodeChanged, now)
            },
        )?;
        // Claims that wait should look again.
        write.made_work |= may_take_tasks_again(change);
        if let Some(cause) = cause_of(change) {
            replans::want(&mut write, &format!("node {} {cause}", changed.name)).await?;
        }
        self.commit(write).await?;
        Ok(changed)
    }

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

/// Makes a node, or updates the one of the same name. If it is new, or not as it was, plans are due.
pub(crate) async fn upsert(
    write: &mut Write,
    registration: &NodeRegistration,
    now: Timestamp,
) -> Result<Node, StoreError> {
    let before = by_name(write.connection().await?, &registration.name).await?;
    let is_replaced = match (&before, registration.worker) {
        (Some(before), Some(worker)) => {
            has_another_worker(write.connection().await?, before.id, worker).await?
        }
        _ => false,
    };
    let node_id: uuid::Uuid = sqlx::query_scalar(
        "INSERT INTO nodes (id, name, speed, price_per_hour, cores, created_at, last_seen_at, capabilities, schedule, worker) \
         VALUES (?, ?, ?, ?, ?, ?6, ?6, ?7, ?8, ?9) ON CONFLICT (name) DO UPDATE SET speed = excluded.speed, \
         price_per_hour = excluded.price_per_hour, cores = excluded.cores, last_seen_at = excluded.last_seen_at, \
         capabilities = excluded.capabilities, schedule = excluded.schedule, \
         worker = coalesce(excluded.worker, worker), paused = 0 RETURNING id",
    )
    .bind(NodeId::new().0)
    .bind(&registration.name)
    .bind(registration.speed)
    .bind(registration.price_per_hour.0)
    .bind(i64::from(registration.cores))
    .bind(now.micros())
    .bind(to_json(&registration.capabilities)?)
    .bind(registration.schedule.as_ref().map(to_json).transpose()?)
    .bind(registration.worker)
    .fetch_one(write.connection().await?)
    .await?;
    if is_replaced {
        // Who had it is dead, or is about to be told.
        take_tasks_away(write, NodeId(node_id), now).await?;
    }
    let node = read(write.connection().await?, NodeId(node_id)).await?;
    match before {
        None => replans::want(write, &format!("node {} joined", node.name)).await?,
        Some(before) if !is_same_machine(&before, &node) || silence(&before, now) > LOST => {
            replans::want(write, &format!("node {} came back", node.name)).await?;
        }
        Some(_) => {}
    }
    append(
        write,
        Event {
            node_id: Some(node.id),
            message: Some(node.name.clone()),
            ..event(EventKind::NodeRegistered, now)
        },
    )?;
    Ok(with_power(node, now))
}

/// Whether the node was registered last by another process than this one.
async fn has_another_worker(
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

/// Takes the tasks away that a node has: they are ready for another, and the node's next renewal brings the order to stop.
pub(crate) async fn take_tasks_away(
    write: &mut Write,
    node: NodeId,
    now: Timestamp,
) -> Result<(), StoreError> {
    let held: Vec<uuid::Uuid> =
        sqlx::query_scalar("SELECT id FROM leases WHERE node_id = ? AND state = 'active' ORDER BY id")
            .bind(node.0)
            .fetch_all(write.connection().await?)
            .await?;
    leases::take_back(write, held, now).await
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

/// Takes the tasks from nodes whose window has ended, if that is what their terms say. Says how many nodes that were.
pub(crate) async fn stop_after_windows(write: &mut Write, now: Timestamp) -> Result<u32, StoreError> {
    let rows = sqlx::query(select_nodes!(
        "WHERE n.terms ->> 'window_end' = 'stop' AND EXISTS (SELECT 1 FROM leases l WHERE l.node_id = n.id AND l.state = 'active') ORDER BY n.id"
    ))
    .fetch_all(write.connection().await?)
    .await?;
    let mut stopped = 0;
    for row in &rows {
        let node = decode(row)?;
        if matches!(opening(&node, now), Opening::Asleep(_)) {
            take_tasks_away(write, node.id, now).await?;
            stopped += 1;
        }
    }
    Ok(stopped)
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
