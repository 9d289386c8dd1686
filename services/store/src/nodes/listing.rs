//! Lists of nodes: filtered, searched and sorted.

use std::time::Duration;

use forelight_protocol::{Money, Node, NodeActivity, NodeId, NodeState, Timestamp};
use serde::{Deserialize, Serialize};
use sqlx::SqliteConnection;

use crate::columns::{Id, Json, hex_list};
use crate::database::Store;
use crate::error::Result;
use crate::nodes::{NodeRow, node_rows};
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
        self.place_of(node.id, &node.name, node.speed, node.price_per_hour)
    }

    fn place_of(self, id: NodeId, name: &str, speed: f64, price: Money) -> NodePlace {
        let number = match self {
            NodeOrder::Speed => speed,
            NodeOrder::Price => price.micro_units() as f64,
            NodeOrder::Created | NodeOrder::Name => 0.0,
        };
        let name = if self == NodeOrder::Name { name.to_owned() } else { String::new() };
        NodePlace { number, name, id }
    }
}

/// A part of a list of nodes.
#[derive(Clone, Copy, Debug)]
pub struct NodeListing<'a> {
    /// Which nodes to list.
    pub filter: &'a NodeFilter,
    /// Their order.
    pub order: NodeOrder,
    /// The place that the part begins behind.
    pub after: Option<&'a NodePlace>,
    /// The most nodes.
    pub limit: u32,
    /// How long a lease lasts: a node that is silent for longer works no more.
    pub lease_ttl: Duration,
    /// The present.
    pub now: Timestamp,
}

impl Store {
    /// The nodes of a list, in the states that they are in now.
    pub async fn listed_nodes(&self, listing: NodeListing<'_>) -> Result<Vec<Node>> {
        let mut transaction = self.read().await?;
        let ids = listing.ids(&mut transaction).await?;
        let rows = node_rows!("WHERE n.id IN (SELECT unhex(value) FROM json_each(?))", ids);
        let mut nodes = listing.nodes(rows.fetch_all(&mut *transaction).await?);
        for node in &mut nodes {
            node.activity = activity(&mut transaction, node).await?;
        }
        Ok(nodes)
    }

    /// The nodes of a list without their tasks and what their machines can do.
    pub async fn listed_nodes_in_brief(&self, listing: NodeListing<'_>) -> Result<Vec<Node>> {
        let mut transaction = self.read().await?;
        let ids = listing.ids(&mut transaction).await?;
        let rows = node_rows!(brief, "WHERE n.id IN (SELECT unhex(value) FROM json_each(?))", ids);
        Ok(listing.nodes(rows.fetch_all(&mut *transaction).await?))
    }
}

impl NodeListing<'_> {
    /// The ids, in their order.
    async fn ids(&self, connection: &mut SqliteConnection) -> Result<Json<Vec<String>>> {
        let search = self.filter.search.as_ref().map(|text| text.to_ascii_lowercase());
        let is_sought =
            |name: &str| search.as_ref().is_none_or(|text| name.to_ascii_lowercase().contains(text.as_str()));
        let mut places: Vec<NodePlace> = match self.filter.state {
            // States depend on the clock and on calendars.
            Some(state) => without_capabilities(connection)
                .await?
                .into_iter()
                .filter(|node| is_sought(&node.name))
                .map(|node| as_it_is(node, self.lease_ttl, self.now))
                .filter(|node| node.state == state)
                .map(|node| self.order.place(&node))
                .collect(),
            None => sqlx::query!(
                r#"SELECT id AS "id: Id", name, coalesce(speed_set, speed) AS "speed!: f64",
                          coalesce(price_set, price_per_hour) AS "price_per_hour!: i64"
                   FROM nodes WHERE removed_at IS NULL"#
            )
            .fetch_all(connection)
            .await?
            .into_iter()
            .filter(|row| is_sought(&row.name))
            .map(|row| {
                let price = Money(row.price_per_hour);
                self.order.place_of(row.id.into(), &row.name, row.speed, price)
            })
            .collect(),
        };
        places.retain(|place| self.after.is_none_or(|after| in_order(place, after).is_gt()));
        places.sort_by(in_order);
        places.truncate(self.limit as usize);
        Ok(hex_list(places.into_iter().map(|place| place.id.0)))
    }

    /// Nodes as they are now, in their order.
    fn nodes(&self, rows: Vec<NodeRow>) -> Vec<Node> {
        let now = |row| as_it_is(Node::from(row), self.lease_ttl, self.now);
        let mut nodes: Vec<Node> = rows.into_iter().map(now).collect();
        nodes.sort_by(|a, b| in_order(&self.order.place(a), &self.order.place(b)));
        nodes
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

/// All nodes without what their machines can do. Oldest first.
pub(crate) async fn without_capabilities(connection: &mut SqliteConnection) -> Result<Vec<Node>> {
    let rows = node_rows!(brief, "WHERE n.removed_at IS NULL ORDER BY n.id").fetch_all(connection).await?;
    Ok(rows.into_iter().map(Node::from).collect())
}
