//! Tasks of a job, as lists show them.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{ArtifactHash, FrameState, NodeId, PageToken, TaskId, TaskKind, Timestamp};

/// A task of a job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TaskRow {
    /// Its id.
    pub id: TaskId,
    /// Its kind.
    pub kind: TaskKind,
    /// Its frame. Absent for previews and the shared cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// The part of the frame or of the irradiance cache, from 0. Absent for other tasks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<u32>,
    /// Its state.
    pub state: FrameState,
    /// The node that has it, or had it last. Absent until then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<NodeId>,
    /// Number of attempts so far.
    pub attempts: u32,
    /// Progress of the present attempt, 0 to 1.
    pub progress: f64,
    /// When the latest attempt started.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started: Option<Timestamp>,
    /// When it ended. Absent until then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finished: Option<Timestamp>,
    /// The finished pixels of a part of a frame, until the frame is put together.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels: Option<ArtifactHash>,
    /// A coarse picture of a frame, as a PNG file, from the task that divided it into parts, until the frame is
    /// put together.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarse_png: Option<ArtifactHash>,
    /// The latest error. Absent if there was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// One page of tasks, oldest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TaskPage {
    /// The tasks.
    pub items: Vec<TaskRow>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}
