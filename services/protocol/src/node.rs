//! Nodes: their registration, orders, terms and state.

use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

use crate::{
    ArtifactHash, ByClass, Money, NodeActivity, NodeCalendar, NodeCalibration, NodeId, NodePower,
    OWN_RENDERER, PageToken, RendererId, TaskId, TimeSpan, Timestamp, WindowEnd,
};

/// Registers a node. A node with the same name is updated; it keeps its id and what an operator set.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeRegistration {
    /// Name of the node, unique on the farm: 1 to 100 characters.
    #[schema(min_length = 1, max_length = 100, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub name: String,
    /// Speed of one of its cores relative to the reference core: 0.001 to 1000.
    #[serde(default = "default_speed")]
    #[schema(default = 1.0, minimum = 0.001, maximum = 1000)]
    pub speed: f64,
    /// Price in micro-units per hour, 0 or more.
    #[serde(default)]
    pub price_per_hour: Money,
    /// Number of cores that its worker uses, 1 to 4096.
    #[serde(default = "default_cores")]
    #[schema(default = 1, minimum = 1, maximum = 4096)]
    pub cores: u32,
    /// Properties of the machine, as far as its worker could find out.
    #[serde(default)]
    pub capabilities: Capabilities,
    /// When the machine is awake. If absent, always.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<NodeCalendar>,
    /// Number of the registering process, chosen by itself. It takes over the node: an earlier process loses
    /// its tasks and gets no new ones. If absent, it does not take over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worker: Option<Uuid>,
}

/// Terms of a node: how its time is billed, when it is closed, and what then happens to running tasks.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct NodeTerms {
    /// Billed time is a multiple of this many seconds, 0 to 604,800. With 0, the exact time is billed.
    #[schema(maximum = 604_800)]
    pub billing_step_seconds: u32,
    /// Shortest billed time in seconds, 0 to 604,800.
    #[schema(maximum = 604_800)]
    pub minimum_booking_seconds: u32,
    /// Time to wake up before the first frame in seconds, 0 to 86,400. It is billed.
    #[schema(maximum = 86_400)]
    pub setup_seconds: u32,
    /// What happens to a task that is still running when a window ends.
    pub window_end: WindowEnd,
    /// Times at which the node is closed, whatever its calendar says. At most 50.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 50)]
    pub maintenance: Vec<TimeSpan>,
}

/// Properties of a machine, as found by its worker.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Capabilities {
    /// Main memory in bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_bytes: Option<u64>,
    /// Name of the processor: 1 to 200 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub processor: Option<String>,
    /// Name, kind and driver of the Vulkan adapter for previews: 1 to 200 characters. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub vulkan_adapter: Option<String>,
    /// Whether that adapter is a hardware GPU, not a software driver.
    #[serde(default)]
    pub gpu: bool,
    /// Version of the worker's program: 1 to 50 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 50, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub version: Option<String>,
    /// Renderers, at most 50. Tasks of their jobs go only to nodes that have them. A worker lists forelight's own
    /// as `forelight`, with its version.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 50)]
    pub renderers: Vec<RendererId>,
    /// Version of ffmpeg: 1 to 50 characters. Absent if the machine cannot encode videos.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 50, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub ffmpeg: Option<String>,
    /// Open Image Denoise and its version: 1 to 50 characters. Absent if the machine cannot remove the noise of
    /// images. Quotes and frames of jobs with `denoise` go only to nodes that can.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 50, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub denoiser: Option<String>,
    /// Speed of one of its cores, by class of work. Absent if it was not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<NodeCalibration>,
}

impl Capabilities {
    /// Most characters of a name.
    const LONGEST_NAME: usize = 200;

    /// Most characters of a program's version.
    pub const LONGEST_VERSION: usize = 50;

    /// Turns the name of a processor or an adapter into one line of 1 to 200 characters. `None` if nothing is
    /// left.
    pub fn name(text: &str) -> Option<String> {
        let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let short: String = line.chars().filter(|c| !c.is_control()).take(Self::LONGEST_NAME).collect();
        (!short.is_empty()).then_some(short)
    }
}

/// Joins a machine to the farm with a one-time token.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JoinRequest {
    /// The node to register. To replace an existing node, the one-time token must be made for its name. The
    /// node's earlier token becomes invalid.
    pub node: NodeRegistration,
    /// BLAKE3 hash of the machine's own future bearer token. The token itself is never sent, so an
    /// eavesdropper does not learn it.
    pub token_hash: ArtifactHash,
}

/// An operator's request for a one-time token.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JoinTokenRequest {
    /// Name of the machine for the token: 1 to 200 characters. It may be that of a node to replace.
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub name: String,
    /// Validity in hours: 1 to 720.
    #[serde(default = "default_hours")]
    #[schema(default = 24, minimum = 1, maximum = 720)]
    pub valid_hours: u32,
}

fn default_hours() -> u32 {
    24
}

/// A one-time token. It is shown only once; the farm stores its hash.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JoinToken {
    /// The token.
    pub token: String,
    /// When the token expires.
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

/// A change to a node. Absent fields stay. A set speed, price or schedule overrides what the node reports;
/// `null` restores the node's own value.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeChange {
    /// Whether to drain the node: it finishes its present task and gets no further ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drain: Option<bool>,
    /// Whether to pause the node: its worker keeps its task, and continues it when this is `false` again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pause: Option<bool>,
    /// `true` takes away the node's present task. Any node may then start it again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cancel_task: Option<bool>,
    /// `true` sets the node aside. `false` brings it back and forgets its failures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set_aside: Option<bool>,
    /// Speed of one core relative to the reference core: 0.001 to 1000. `null` restores the node's own.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<f64>, minimum = 0.001, maximum = 1000)]
    pub speed: Option<Option<f64>>,
    /// Price in micro-units per hour, 0 or more. `null` restores the node's own value.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<Money>)]
    pub price_per_hour: Option<Option<Money>>,
    /// When the node is awake. `null` restores the node's own schedule.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<NodeCalendar>)]
    pub schedule: Option<Option<NodeCalendar>>,
    /// All terms of the node. Terms that are left out get their default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub terms: Option<NodeTerms>,
}

/// Distinguishes `null` (`Some(None)`) from a field that is left out (`None`, the default).
pub(crate) fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<Option<T>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

/// State of a node with respect to its orders.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NodeState {
    /// It has no task.
    #[default]
    Idle,
    /// It has a task.
    Working,
    /// It was ordered to pause, but its worker has not confirmed yet.
    Pausing,
    /// It is paused.
    Paused,
    /// It finishes its present task and gets no further ones.
    Draining,
    /// It is drained and has no task.
    Drained,
    /// It gets no tasks, because too many failed on it. See `set_aside`.
    SetAside,
    /// It sent no request for three lease times in which it should have been awake.
    Silent,
}

impl Node {
    /// The version of our own renderer that it has, if it says so.
    pub fn own_version(&self) -> Option<&str> {
        let own = self.capabilities.renderers.iter().find(|id| id.name == OWN_RENDERER);
        own.map(|id| id.version.as_str())
    }

    /// Whether it may get tasks.
    pub fn takes_tasks(&self) -> bool {
        !self.drain && !self.pause && self.set_aside.is_none()
    }

    /// Calibrated speed of one core for this mix of work. `None` without a calibration or mix, or if an
    /// operator set the speed.
    pub fn speed_by_class(&self, work: Option<&ByClass>) -> Option<f64> {
        self.capabilities.calibration.as_ref().filter(|_| !self.speed_set)?.speed(work?)
    }

    /// The same, corrected by the times of finished frames on this node.
    pub fn corrected_speed(&self, work: Option<&ByClass>) -> Option<f64> {
        Some(self.speed_by_class(work)? / self.time_factor)
    }

    /// Best known speed of one core for this mix of work: by its corrected calibration, else its plain speed.
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
    /// Speed of one of its cores relative to the reference core.
    pub speed: f64,
    /// Whether an operator set the speed.
    pub speed_set: bool,
    /// Price in micro-units per hour.
    pub price_per_hour: Money,
    /// Whether an operator set the price.
    pub price_set: bool,
    /// Factor on its calibrated time, learnt from finished frames that were profiled on other nodes. 1 at
    /// first.
    #[serde(default = "one")]
    pub time_factor: f64,
    /// Number of cores that its worker uses.
    pub cores: u32,
    /// Properties of the machine.
    #[serde(default)]
    pub capabilities: Capabilities,
    /// When the machine is awake. If absent, always.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<NodeCalendar>,
    /// Whether an operator set the schedule.
    #[serde(default)]
    pub schedule_set: bool,
    /// Its terms.
    #[serde(default)]
    pub terms: NodeTerms,
    /// Whether it is awake, by its schedule and maintenance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power: Option<NodePower>,
    /// Its state with respect to its orders.
    #[serde(default)]
    pub state: NodeState,
    /// Whether it was ordered to drain.
    pub drain: bool,
    /// Whether it was ordered to pause.
    #[serde(default)]
    pub pause: bool,
    /// Why it was set aside. Absent if it was not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set_aside: Option<String>,
    /// Why it got none of the ready frames when it last asked, for example because it is more expensive.
    /// Absent if there were none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub idle_reason: Option<String>,
    /// The task that it holds. Absent if it has none.
    pub task_id: Option<TaskId>,
    /// What that task is, for those who see its job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub activity: Option<NodeActivity>,
    /// When it was first registered.
    pub created_at: Timestamp,
    /// When it last sent a request.
    pub last_seen_at: Timestamp,
}

/// One page of nodes, oldest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NodePage {
    /// The nodes.
    pub items: Vec<Node>,
    /// Token of the next page. Absent on the last page.
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
