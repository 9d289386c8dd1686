//! Nodes.

use forelight_protocol::{
    Event, EventKind, Money, Node, NodeChange, NodeId, NodeRegistration, TaskId, Timestamp,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::decode::{id, id_opt, time, whole};
use crate::events::{append, event};
use crate::idempotency::{Answered, IdempotencyKey, earlier_answer, record};
use crate::{Store, StoreError};

macro_rules! select_nodes {
    ($rest:literal) => {
        concat!(
            "SELECT n.*, (SELECT l.task_id FROM leases l WHERE l.node_id = n.id AND l.state = 'active' ",
            "ORDER BY l.granted_at DESC, l.id LIMIT 1) AS task_id FROM nodes n ",
            $rest
        )
    };
}

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
        let node_id: uuid::Uuid = sqlx::query_scalar(
            "INSERT INTO nodes (id, name, speed, price_per_hour, cores, created_at, last_seen_at) \
             VALUES (?, ?, ?, ?, ?, ?6, ?6) ON CONFLICT (name) DO UPDATE SET speed = excluded.speed, \
             price_per_hour = excluded.price_per_hour, cores = excluded.cores, last_seen_at = excluded.last_seen_at RETURNING id",
        )
        .bind(NodeId::new().0)
        .bind(&registration.name)
        .bind(registration.speed)
        .bind(registration.price_per_hour.0)
        .bind(i64::from(registration.cores))
        .bind(now.micros())
        .fetch_one(write.connection())
        .await?;
        let node = read(write.connection(), NodeId(node_id)).await?;
        append(
            &mut write,
            Event {
                node_id: Some(node.id),
                message: Some(node.name.clone()),
                ..event(EventKind::NodeRegistered, now)
            },
        )
        .await?;
        record(&mut write, key, 201, &node, now).await?;
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
            "UPDATE nodes SET drain = coalesce(?, drain), speed_set = CASE WHEN ? THEN ? ELSE speed_set END, \
             price_set = CASE WHEN ? THEN ? ELSE price_set END WHERE id = ?",
        )
        .bind(change.drain)
        .bind(change.speed.is_some())
        .bind(change.speed.flatten())
        .bind(change.price_per_hour.is_some())
        .bind(change.price_per_hour.flatten().map(Money::micro_units))
        .bind(node.0)
        .execute(write.connection())
        .await?;
        let changed = read(write.connection(), node).await?;
        append(
            &mut write,
            Event {
                node_id: Some(node),
                message: Some(changed.name.clone()),
                ..event(EventKind::NodeChanged, now)
            },
        )
        .await?;
        // Whoever waits on behalf of a node that is no longer draining should look again.
        write.made_work = change.drain == Some(false);
        self.commit(write).await?;
        Ok(changed)
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

pub(crate) async fn read(connection: &mut SqliteConnection, node: NodeId) -> Result<Node, StoreError> {
    let row = sqlx::query(select_nodes!("WHERE n.id = ?")).bind(node.0).fetch_optional(connection).await?;
    decode(&row.ok_or(StoreError::NotFound("node"))?)
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

fn decode(row: &SqliteRow) -> Result<Node, StoreError> {
    let speed_set: Option<f64> = row.try_get("speed_set")?;
    let price_set: Option<i64> = row.try_get("price_set")?;
    Ok(Node {
        id: NodeId(id(row, "id")?),
        name: row.try_get("name")?,
        speed: speed_set.map_or_else(|| row.try_get("speed"), Ok)?,
        speed_set: speed_set.is_some(),
        price_per_hour: Money(price_set.map_or_else(|| row.try_get("price_per_hour"), Ok)?),
        price_set: price_set.is_some(),
        cores: whole(row, "cores")?,
        drain: row.try_get("drain")?,
        task_id: id_opt(row, "task_id")?.map(TaskId),
        created_at: time(row, "created_at")?,
        last_seen_at: time(row, "last_seen_at")?,
    })
}
