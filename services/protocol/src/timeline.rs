//! Charts of large farms: nodes against time, and the frames of a job in a row.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{FrameSet, JobId, Money, NodeId, NodeState, PageToken, Timestamp};

/// What a node does in a stretch of time.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SpanKind {
    /// It worked for a job.
    Past,
    /// It works for a job. The end is expected.
    Running,
    /// It is booked for a job. The end is expected.
    Booked,
    /// It is closed for maintenance.
    Maintenance,
    /// It is asleep by its schedule.
    Asleep,
}

/// A stretch of a node's time. Neighbouring bookings of one job are one span.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TimelineSpan {
    /// The job. Absent while the node is closed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_id: Option<JobId>,
    /// The frames. Absent while the node is closed, and for work on no single frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<FrameSet>,
    /// What it does.
    pub kind: SpanKind,
    /// Begin.
    pub start: Timestamp,
    /// End. For bookings, the median.
    pub end: Timestamp,
    /// End of a booking at P80. Absent for all other kinds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub end_p80: Option<Timestamp>,
}

/// A node and what it does between two instants.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TimelineNode {
    /// The node.
    pub node_id: NodeId,
    /// Its name.
    pub name: String,
    /// Its state.
    pub state: NodeState,
    /// Speed of one of its cores relative to the reference core.
    pub speed: f64,
    /// Price in micro-units per hour.
    pub price_per_hour: Money,
    /// Why it got none of the ready frames when it last asked. Absent if there were none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub idle_because: Option<String>,
    /// Its spans, by start.
    pub spans: Vec<TimelineSpan>,
}

/// A job and its name.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobName {
    /// The job.
    pub id: JobId,
    /// Its name.
    pub name: String,
}

/// One page of nodes by name, with what they do between two instants.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TimelinePage {
    /// The nodes.
    pub items: Vec<TimelineNode>,
    /// The jobs in their spans.
    pub jobs: Vec<JobName>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

/// What the numbers of a strip are.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StripQuantity {
    /// CPU seconds on a node of speed 1.
    #[default]
    CpuSeconds,
    /// Work: a count of operations.
    Work,
    /// Micro-units of money. Forecasts are at the quoted price of a CPU second.
    Cost,
}

/// All frames of a job in a row. Numbers have three digits; `/v1/jobs/{id}/frames` has all of them.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameStrip {
    /// The job.
    pub job_id: JobId,
    /// What the numbers are.
    pub quantity: StripQuantity,
    /// The frames. All lists have one entry for each, ascending.
    pub frames: FrameSet,
    /// One letter for each frame: `w` waiting, `b` booked, `r` running, `d` done, `f` failed, `c` cancelled.
    pub states: String,
    /// The frames that were profiled. Absent if none was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profiled: Option<FrameSet>,
    /// Median of each frame's forecast. `null` before the job is quoted.
    pub p50: Vec<Option<f64>>,
    /// 80 % quantiles.
    pub p80: Vec<Option<f64>>,
    /// 95 % quantiles.
    pub p95: Vec<Option<f64>>,
    /// The true value. `null` until the frame is done.
    pub actual: Vec<Option<f64>>,
}
