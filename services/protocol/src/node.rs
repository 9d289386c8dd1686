//! Nodes.

use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

use crate::{Money, NodeId, PageToken, TaskId, Timestamp};

/// A node announces itself. A node of the same name is updated, and keeps its id; its speed and price too, if they were set
/// by hand.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeRegistration {
    /// Its name, unique on the farm: 1 to 100 characters.
    #[schema(min_length = 1, max_length = 100)]
    pub name: String,
    /// Speed of one of its cores against the reference: above 0, to 1000.
    #[serde(default = "default_speed")]
    #[schema(default = 1.0, exclusive_minimum = 0, maximum = 1000)]
    pub speed: f64,
    /// Micro-units per hour, 0 or more.
    #[serde(default)]
    pub price_per_hour: Money,
    /// Cores that its worker uses, 1 to 4096.
    #[serde(default = "default_cores")]
    #[schema(default = 1, minimum = 1, maximum = 4096)]
    pub cores: u32,
}

fn default_speed() -> f64 {
    1.0
}

fn default_cores() -> u32 {
    1
}

/// A change to a node; what is left out stays. A speed or price that is set so holds whatever the node says of itself when it
/// registers again; `null` gives it up, and what the node said last holds.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeChange {
    /// Whether to hand it no further tasks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drain: Option<bool>,
    /// Speed of one of its cores against the reference, above 0, to 1000; `null`: as the node says.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<f64>, exclusive_minimum = 0, maximum = 1000)]
    pub speed: Option<Option<f64>>,
    /// Micro-units per hour, 0 or more; `null`: as the node says.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<Money>)]
    pub price_per_hour: Option<Option<Money>>,
}

/// Tells `null` (`Some(None)`) from a field that is left out (`None`, the default).
fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<Option<T>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

/// A node.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Node {
    /// Its id.
    pub id: NodeId,
    /// Its name.
    pub name: String,
    /// Speed of one of its cores against the reference.
    pub speed: f64,
    /// Whether the speed was set by hand.
    pub speed_set: bool,
    /// Micro-units per hour.
    pub price_per_hour: Money,
    /// Whether the price was set by hand.
    pub price_set: bool,
    /// Cores that its worker uses.
    pub cores: u32,
    /// Whether it gets no further tasks.
    pub drain: bool,
    /// The task that it holds, if any.
    pub task_id: Option<TaskId>,
    /// When it was first registered.
    pub created_at: Timestamp,
    /// When it was last heard of.
    pub last_seen_at: Timestamp,
}

/// One page of nodes, oldest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NodePage {
    /// The nodes.
    pub items: Vec<Node>,
    /// Where the next page starts; absent on the last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_that_is_null_is_another_change_than_one_that_is_left_out() {
        let change = |json: &str| serde_json::from_str::<NodeChange>(json).unwrap();
        assert_eq!(change("{}"), NodeChange::default());
        let reset = change(r#"{"speed": null, "price_per_hour": 5}"#);
        assert_eq!((reset.speed, reset.price_per_hour), (Some(None), Some(Some(Money(5)))));
        for change in [reset, NodeChange { drain: Some(true), ..NodeChange::default() }] {
            let json = serde_json::to_string(&change).unwrap();
            assert_eq!(serde_json::from_str::<NodeChange>(&json).unwrap(), change, "{json}");
        }
    }
}
