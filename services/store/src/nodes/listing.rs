//! Lists of nodes: filtered, searched and sorted.

use std::time::Duration;

use forelight_protocol::{Node, NodeActivity, NodeId, NodeState, Timestamp};
use serde::{Deserialize, Serialize};
use sqlx::SqliteConnection;

use crate::database::Store;
use crate::error::Result;
use crate::nodes::{NodeRow, read};
use crate::policy::availability::as_it_is;

/// Which nodes to list.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct NodeFilter {
    /// Only nodes in this state.
    pub state: Option<NodeState>,
    /// Only nodes with this text in their names, whatever its case in ASCII.
    pub search: Option<String>,
}

/// The order of a list of nodes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum NodeOrder {
    /// Oldest first.
    #[default]
    Created,
    /// By name.
    Name,
    /// Slowest core first.
    Speed,
    /// Cheapest hour first.
    Price,
}

/// A node's place in an order.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct NodePlace {
    /// Its speed or price; 0 in other orders.
    pub number: f64,
    /// Its name in the order of names.
    pub name: String,
    /// Its id, which decides between equals.
    pub id: NodeId,
}

impl NodeOrder {
    /// The place of a node.
    pub fn place(self, node: &Node) -> NodePlace {
        let number = match self {
            NodeOrder::Speed => node.speed,
            NodeOrder::Price => node.price_per_hour.micro_units() as f64,
            NodeOrder::Created | NodeOrder::Name => 0.0,
        };
        let name = if self == NodeOrder::Name { node.name.clone() } else { String::new() };
        NodePlace { number, name, id: node.id }
    }
}

impl Store {
    /// The nodes after `after` that match, in this order and in the states that they are in now, at most
    /// `limit`.
    pub async fn listed_nodes(
        &self,
        filter: &NodeFilter,
        (order, after): (NodeOrder, Option<&NodePlace>),
        limit: u32,
        (ttl, now): (Duration, Timestamp),
    ) -> Result<Vec<Node>> {
        let mut transaction = self.read().await?;
        let search = filter.search.as_ref().map(|text| text.to_ascii_lowercase());
        let mut nodes: Vec<Node> = without_capabilities(&mut transaction)
            .await?
            .into_iter()
            .filter(|node| {
                search.as_ref().is_none_or(|text| node.name.to_ascii_lowercase().contains(text.as_str()))
            })
            .map(|node| as_it_is(node, ttl, now))
            .filter(|node| filter.state.is_none_or(|state| node.state == state))
            .collect();
        let key = |node: &Node| order.place(node);
        nodes.sort_by(|a, b| in_order(&key(a), &key(b)));
        let later = nodes.iter().filter(|node| after.is_none_or(|after| in_order(&key(node), after).is_gt()));
        let ids: Vec<NodeId> = later.take(limit as usize).map(|node| node.id).collect();
        let mut found = Vec::with_capacity(ids.len());
        for id in ids {
            let mut node = read(&mut transaction, id).await?;
            node.activity = activity(&mut transaction, &node).await?;
            found.push(as_it_is(node, ttl, now));
        }
        Ok(found)
    }
}

/// What a node's task is.
pub(crate) async fn activity(connection: &mut SqliteConnection, node: &Node) -> Result<Option<NodeActivity>> {
    if node.task_id.is_none() {
        return Ok(None);
    }
    let activity = sqlx::query_as!(
        NodeActivity,
        r#"SELECT t.id AS task_id, t.kind, t.job_id, j.name AS job, t.frame,
                  round(t.progress, 4) AS "progress!: f64", t.started_at AS "started!"
           FROM tasks t JOIN jobs j ON j.id = t.job_id
           WHERE t.node_id = ? AND t.state = 'leased' ORDER BY t.started_at DESC, t.id LIMIT 1"#,
        node.id.0
    )
    .fetch_optional(connection)
    .await?;
    Ok(activity)
}

fn in_order(a: &NodePlace, b: &NodePlace) -> std::cmp::Ordering {
    a.number.total_cmp(&b.number).then_with(|| a.name.cmp(&b.name)).then(a.id.cmp(&b.id))
}

/// All nodes without what their machines can do, which is by far the most of them. Oldest first.
pub(crate) async fn without_capabilities(connection: &mut SqliteConnection) -> Result<Vec<Node>> {
    let rows = sqlx::query_as!(
        NodeRow,
        r#"SELECT n.id, n.name, n.speed, n.speed_set, n.price_per_hour, n.price_set, n.cores, n.drain,
                  n.pause, n.paused, n.set_aside, n.idle_reason,
                  '{}' AS "capabilities!: crate::columns::Json<forelight_protocol::Capabilities>",
                  n.learned_millionths, n.learned_jobs, n.schedule, n.schedule_set, n.terms, n.created_at,
                  n.last_seen_at,
                  (SELECT l.task_id FROM leases l WHERE l.node_id = n.id AND l.state = 'active'
                   ORDER BY l.granted_at DESC, l.id LIMIT 1) AS "task_id?: crate::columns::Id"
           FROM nodes n WHERE n.removed_at IS NULL ORDER BY n.id"#
    )
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().map(Node::from).collect())
}
