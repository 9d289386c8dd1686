//! Frames of a job: how far they are, and what they were forecast to cost and cost.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::division::{is_one, one};
use crate::{ArtifactHash, FrameForecast, FrameSet, NodeId, PageToken, Quantiles, RenderStats, Timestamp};

/// State of a frame, or of a task.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameState {
    /// Waiting for the quote, or for another task.
    Waiting,
    /// Ready to be rendered.
    Ready,
    /// Leased by a worker. A divided frame: one of its parts was.
    Leased,
    /// Finished.
    Done,
    /// Failed, after all attempts.
    Failed,
    /// The job failed or was cancelled before the frame was rendered.
    Cancelled,
}

/// Some frames of a job.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FramesRequest {
    /// The frames, all of them the job's.
    pub frames: FrameSet,
}

/// Where and when a frame is booked.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameBooking {
    /// The node.
    pub node_id: NodeId,
    /// Name of the node.
    pub node: String,
    /// Start of the booking.
    pub start: Timestamp,
    /// End of the booking.
    pub end: Timestamp,
}

/// Where a frame's image is written besides its artefacts.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameOutput {
    /// Path below the service's output root.
    pub path: String,
    /// Whether it is there.
    pub written: bool,
    /// Why it could not be written last. It is tried again. Absent if it could.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// The artefacts of a frame. Each is absent until it exists.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct FrameArtifacts {
    /// The preview: object and material ids as colours.
    pub preview_png: Option<ArtifactHash>,
    /// The cost of each pixel as a colour.
    pub cost_map_png: Option<ArtifactHash>,
    /// The image, for display.
    pub image_png: Option<ArtifactHash>,
    /// The image with linear values.
    pub image_exr: Option<ArtifactHash>,
}

/// Forecast and actual value of one number.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameFigure {
    /// The forecast.
    pub forecast: Quantiles,
    /// The actual value. Absent until the frame is done.
    pub actual: Option<f64>,
    /// Forecast mean / actual − 1. Absent until the frame is done, and if the actual value is 0.
    pub error: Option<f64>,
}

/// One frame of a job: its forecast and its actual cost.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameRow {
    /// Frame number.
    pub frame: u32,
    /// Its state.
    pub state: FrameState,
    /// The complete forecast. Absent until the job is quoted.
    pub forecast: Option<FrameForecast>,
    /// The complete actual cost. Absent until the frame is done.
    pub actual: Option<RenderStats>,
    /// Work: forecast, actual value and error.
    pub work: Option<FrameFigure>,
    /// CPU seconds: forecast, actual value and error. All are for a node of speed 1.
    pub cpu_seconds: Option<FrameFigure>,
    /// Where and when it is booked; of a divided frame, its first part. Absent if it is not.
    pub booked: Option<FrameBooking>,
    /// Into how many parts it is divided. 1 or absent: it is rendered as a whole.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    #[schema(default = 1, minimum = 1, maximum = 512)]
    pub parts: u32,
    /// Number of its finished parts. 0 of a whole frame.
    #[serde(default, skip_serializing_if = "crate::is_zero")]
    pub parts_done: u32,
    /// The node that renders or rendered it. Absent until then.
    pub node: Option<NodeId>,
    /// Number of attempts so far.
    pub attempts: u32,
    /// Progress of the present attempt, 0 to 1; of a divided frame, that of all parts.
    pub progress: f64,
    /// When the latest attempt started.
    pub started: Option<Timestamp>,
    /// When the result was committed. Absent until then.
    pub finished: Option<Timestamp>,
    /// Its files.
    pub artifacts: FrameArtifacts,
    /// Where its image is written besides. Absent if it is nowhere else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<FrameOutput>,
    /// The latest error. Absent if there was none.
    pub error: Option<String>,
}

/// One page of frames, ascending.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FramePage {
    /// The frames.
    pub items: Vec<FrameRow>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}
