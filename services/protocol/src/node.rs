//! Nodes.

use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

use crate::{
    ArtifactHash, ByClass, Money, NodeCalendar, NodeCalibration, NodeId, NodePower, PageToken, TaskId,
    TimeSpan, Timestamp, WindowEnd,
};

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
    /// What else the machine has, as far as its worker could find out.
    #[serde(default)]
    pub capabilities: Capabilities,
    /// When the machine is awake; absent: always.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<NodeCalendar>,
    /// The process that registers, by a number of its own. It takes the node over from an earlier one: what that one had goes back, and its
    /// claims are refused. Absent: a process of a moment, which leaves the node to whoever has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worker: Option<Uuid>,
}

/// On which terms a node is had: how its time is billed, when it is closed, and what happens then.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct NodeTerms {
    /// Rented time is billed in multiples of this many seconds, 0 to 604,800; 0: as it is.
    #[schema(maximum = 604_800)]
    pub billing_step_seconds: u32,
    /// The least rented time that is billed, in seconds, 0 to 604,800.
    #[schema(maximum = 604_800)]
    pub minimum_booking_seconds: u32,
    /// Seconds that it takes to wake up before the first frame, 0 to 86,400; they are billed.
    #[schema(maximum = 86_400)]
    pub setup_seconds: u32,
    /// What becomes of a task that still runs when a window ends.
    pub window_end: WindowEnd,
    /// When the node is closed whatever its calendar says, at most 50.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 50)]
    pub maintenance: Vec<TimeSpan>,
}

/// What a machine has, as its worker found it.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Capabilities {
    /// Main memory in bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_bytes: Option<u64>,
    /// Name of the processor: 1 to 200 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub processor: Option<String>,
    /// Name, kind and driver of the Vulkan adapter that previews are made with: 1 to 200 characters; absent if they are made on the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub vulkan_adapter: Option<String>,
    /// Whether that adapter is a graphics processor, and no program that does its work.
    #[serde(default)]
    pub gpu: bool,
    /// How fast one of its cores is, by class of work.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<NodeCalibration>,
}

/// A machine joins the farm with a one-time token.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JoinRequest {
    /// The node that it will be. If there is one of this name, the one-time token must have been made in that name: the machine takes
    /// that node's place, and the token that the other one had is void.
    pub node: NodeRegistration,
    /// BLAKE3 of the bearer token that the machine made for itself and will show from now on. The token itself stays there: an
    /// answer that gets lost costs nothing, and nobody who listens learns it.
    pub token_hash: ArtifactHash,
}

/// An operator asks for a one-time token.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JoinTokenRequest {
    /// Whom it is for: 1 to 200 characters. The name of a node lets the machine take that node's place.
    #[schema(min_length = 1, max_length = 200)]
    pub name: String,
    /// Hours for which it may be used: 1 to 720.
    #[serde(default = "default_hours")]
    #[schema(default = 24, minimum = 1, maximum = 720)]
    pub valid_hours: u32,
}

fn default_hours() -> u32 {
    24
}

/// A one-time token. This is the only time that it is said; the farm keeps its hash.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JoinToken {
    /// The token.
    pub token: String,
    /// Until when it may be used.
    pub expires_at: Timestamp,
}

fn default_speed() -> f64 {
    1.0
}

fn one() -> f64 {
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
    /// Whether to hand it no further tasks; it finishes the one that it has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drain: Option<bool>,
    /// Whether to stand still: its worker keeps the task that it has and goes on with it when this is taken back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pause: Option<bool>,
    /// `true`: take away the task that it has. Another node starts it anew; so may this one, unless it is drained as well.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cancel_task: Option<bool>,
    /// `true`: set it aside by hand; `false`: bring it back, and forgive what made the farm set it aside.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set_aside: Option<bool>,
    /// Speed of one of its cores against the reference, above 0, to 1000; `null`: as the node says.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<f64>, exclusive_minimum = 0, maximum = 1000)]
    pub speed: Option<Option<f64>>,
    /// Micro-units per hour, 0 or more; `null`: as the node says.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<Money>)]
    pub price_per_hour: Option<Option<Money>>,
    /// When it is awake; `null`: as the node says.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<NodeCalendar>)]
    pub schedule: Option<Option<NodeCalendar>>,
    /// On which terms it is had: all of them, those that are left out as they are by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub terms: Option<NodeTerms>,
}

/// Tells `null` (`Some(None)`) from a field that is left out (`None`, the default).
fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<Option<T>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

/// What a node is doing about the orders that it was given.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NodeState {
    /// Has nothing to do.
    #[default]
    Idle,
    /// Has a task.
    Working,
    /// Was told to stand still; its worker has not heard it yet.
    Pausing,
    /// Stands still.
    Paused,
    /// Gets no further tasks, and finishes the one that it has.
    Draining,
    /// Gets no further tasks, and has none.
    Drained,
    /// Gets no tasks, because too much failed on it: see `set_aside`.
    SetAside,
    /// Was not heard of for three lease times in which it should have been awake.
    Silent,
}

impl Node {
    /// Whether it may be given tasks.
    pub fn takes_tasks(&self) -> bool {
        !self.drain && !self.pause && self.set_aside.is_none()
    }

    /// Speed of one of its cores for this work, as its calibration says; `None` if it has none, if its speed was set by hand, which then
    /// holds, or if the classes of the work are not known.
    pub fn speed_by_class(&self, work: Option<&ByClass>) -> Option<f64> {
        self.capabilities.calibration.as_ref().filter(|_| !self.speed_set)?.speed(work?)
    }

    /// The same, corrected by what frames took on the node.
    pub fn corrected_speed(&self, work: Option<&ByClass>) -> Option<f64> {
        Some(self.speed_by_class(work)? / self.time_factor)
    }

    /// Seconds of a core of speed 1 that one of its cores does in a second of this work: as its calibration, corrected, says, or its speed where that
    /// says nothing.
    pub fn speed_for(&self, work: Option<&ByClass>) -> f64 {
        self.corrected_speed(work).unwrap_or(self.speed)
    }
}

impl NodeState {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            NodeState::Idle => "idle",
            NodeState::Working => "working",
            NodeState::Pausing => "pausing",
            NodeState::Paused => "paused",
            NodeState::Draining => "draining",
            NodeState::Drained => "drained",
            NodeState::SetAside => "set_aside",
            NodeState::Silent => "silent",
        }
    }
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
    /// By what factor frames of jobs that were profiled on other nodes took longer on it than its calibration says, as far as finished frames
    /// tell.
    #[serde(default = "one")]
    pub time_factor: f64,
    /// Cores that its worker uses.
    pub cores: u32,
    /// What else the machine has.
    #[serde(default)]
    pub capabilities: Capabilities,
    /// When it is awake; absent: always.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<NodeCalendar>,
    /// Whether that was set by hand.
    #[serde(default)]
    pub schedule_set: bool,
    /// On which terms it is had.
    #[serde(default)]
    pub terms: NodeTerms,
    /// Whether it is awake by calendar and maintenance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power: Option<NodePower>,
    /// What it is doing about its orders.
    #[serde(default)]
    pub state: NodeState,
    /// Whether it gets no further tasks.
    pub drain: bool,
    /// Whether it is to stand still.
    #[serde(default)]
    pub pause: bool,
    /// Why it was set aside; absent if it was not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set_aside: Option<String>,
    /// Why it got none of the frames that there are when it last asked, such as that it is dearer than the nodes where they are booked; absent
    /// if there was nothing to pass over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub idle_reason: Option<String>,
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
