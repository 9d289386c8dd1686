//! Frames that are divided into parts, which different nodes render at the same time.
//!
//! A *part* is pixels or samples of one frame. Parts of pixels have equal forecast cost, not equal area. The
//! pixels of an image have a fixed order along a space-filling curve, and a part is a range of it, so each
//! part is compact. The image of a divided frame has the same bits as that of a whole one.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, BundleSource, ErrorTarget, JobId, JobSettings, RenderSettings, RendererRequest,
    SampleShare, SceneDigest, Spent,
};

/// Largest number of parts of a frame.
pub const MOST_PARTS: u32 = 512;

/// Whether the frames of a job are divided. In JSON `"auto"`, `"whole"` or `{"into": 8}`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Division {
    /// The plan divides long frames where that keeps a deadline or ends the job earlier.
    #[default]
    Auto,
    /// Every frame is rendered by one node.
    Whole,
    /// Every frame is divided into this many parts, 2 to 512.
    Into(PartCount),
}

impl Division {
    /// Whether it is the default.
    pub fn is_auto(&self) -> bool {
        *self == Self::Auto
    }
}

/// Number of parts of a frame: 2 to 512.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[schema(minimum = 2, maximum = 512)]
pub struct PartCount(pub u32);

/// A frame, or one part of it: what a plan books on one node.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct FramePart {
    /// The frame.
    pub frame: u32,
    /// The part, from 0.
    pub part: u32,
    /// Number of parts of the frame. 1: it is the whole frame.
    pub parts: u32,
}

impl From<u32> for FramePart {
    /// The whole frame.
    fn from(frame: u32) -> Self {
        Self { frame, part: 0, parts: 1 }
    }
}

impl fmt::Display for FramePart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.parts {
            1 => write!(f, "frame {}", self.frame),
            parts => write!(f, "frame {}, part {} of {parts}", self.frame, self.part + 1),
        }
    }
}

/// What belongs to one part of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PartRange {
    /// A range of the image's pixels, in their order along the curve.
    Pixels(PixelRange),
    /// A range of the samples of every pixel.
    Samples(SampleRange),
}

/// Pixels by their place along the curve.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PixelRange {
    /// Place of the first pixel.
    pub from: u32,
    /// Place after the last pixel.
    pub to: u32,
}

/// Samples of every pixel.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SampleRange {
    /// Number of samples before it.
    pub offset: u32,
    /// Number of samples.
    pub count: u32,
}

/// Task: find parts of equal forecast cost in one frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct DivideSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// Expected hash of the scene's files. A worker that finds other files fails the task permanently.
    pub digest: SceneDigest,
    /// The frame.
    pub frame: u32,
    /// The job's settings.
    pub settings: RenderSettings,
    /// Number of parts.
    pub parts: u32,
    /// Finished pixels of this frame's profile. They cost nothing more. Absent if it was not profiled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<ArtifactHash>,
    /// The complete shared irradiance cache. Absent without one, and while the task waits for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
    /// The complete irradiance cache of the frame. Absent without one, and until it is planned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_cache: Option<ArtifactHash>,
    /// How far the frame is, if it is rendered in passes. Absent if every pixel gets the settings' samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub passes: Option<Passes>,
}

/// A divided frame whose samples go where they reduce the error most. The nodes share the pixels of each
/// pass. After it, the frame is divided anew: the image so far shows where the next samples go.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Passes {
    /// Largest work of the frame. With an error target, its forecast.
    pub work: u64,
    /// The image is finished when its error is small enough. Absent: when the work is spent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_target: Option<ErrorTarget>,
    /// Unfinished pixels after the last pass: the files of its parts. Empty before the first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 512)]
    pub before: Vec<ArtifactHash>,
}

/// Result of dividing a frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DivideResult {
    /// Where each part ends along the curve, ascending. One entry per part; the last is the number of pixels.
    /// Empty if the frame is rendered in passes, and the last one is over.
    #[schema(max_items = 512)]
    pub ends: Vec<u32>,
    /// Forecast work of each part, without what every part pays for itself.
    #[schema(max_items = 512)]
    pub work: Vec<u64>,
    /// The irradiance cache of the frame, planned. Its missing records are gathered before the parts start.
    /// Absent without a cache, and if the shared cache is all that the frame needs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<FrameCache>,
    /// A picture of the frame before its parts: from the camera samples that told what they will cost, or
    /// after the last pass. Light from an irradiance cache that is not filled yet is missing in it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarse_png: Option<ArtifactHash>,
    /// File with the number of samples that each pixel has after the next pass. Absent if the frame is not
    /// rendered in passes, and after the last one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<ArtifactHash>,
    /// With an error target: work that the pixels of the frame will probably take in all, by the image so far.
    /// Absent before the first pass.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_work: Option<u64>,
    /// Cost of the task.
    pub spent: Spent,
}

/// The irradiance cache of a divided frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FrameCache {
    /// The cache.
    pub hash: ArtifactHash,
    /// Its size in bytes.
    pub bytes: u64,
    /// Whether all of its records are filled.
    pub full: bool,
}

/// Task: render one part of a frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct RenderPartSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// Expected hash of the scene's files. A worker that finds other files fails the task permanently.
    pub digest: SceneDigest,
    /// The frame.
    pub frame: u32,
    /// The job's settings.
    pub settings: JobSettings,
    /// The renderer. Absent for forelight's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<RendererRequest>,
    /// The part, from 0.
    pub part: u32,
    /// Number of parts of the frame.
    pub parts: u32,
    /// What belongs to the part. Absent while the frame is being divided.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<PartRange>,
    /// Finished pixels of this frame's profile, to take over. Absent if it was not profiled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<ArtifactHash>,
    /// The complete shared irradiance cache. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
    /// The complete irradiance cache of the frame. Absent without one, and if the shared one is enough.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_cache: Option<ArtifactHash>,
    /// The pass, if the frame is rendered in passes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pass: Option<PartPass>,
}

impl RenderPartSpec {
    /// What the part has to render, in a pass too. `None` while the frame is being divided.
    pub fn assigned_range(&self) -> Option<PartRange> {
        self.range.or_else(|| self.pass.as_ref().map(|pass| PartRange::Pixels(pass.pixels)))
    }
}

/// What a part does in one pass over a frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PartPass {
    /// The pixels of the part. Parts of passes have no other range, so that a worker which knows no passes
    /// cannot render them in another way.
    pub pixels: PixelRange,
    /// File with the number of samples that each pixel of the image has after the pass.
    pub samples: ArtifactHash,
    /// Files with earlier samples of these pixels. Empty in the first pass.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 512)]
    pub before: Vec<ArtifactHash>,
}

/// Result of rendering one part of a frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderPartResult {
    /// What is finished.
    pub finished: FinishedPart,
    /// What is left, if the worker was told to leave the rest of its pixels to other nodes. Absent if nothing
    /// is. In a pass, the file of the part then has the samples so far of all its pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest: Option<RestOfPart>,
    /// Cost of the task, including what each part pays for itself: loading, its acceleration structure.
    pub spent: Spent,
    /// Largest resident memory in bytes. 0 if unknown.
    #[serde(default)]
    pub peak_memory_bytes: u64,
}

/// Where a part is divided again that takes longer than forecast. The first piece is finished; others are new
/// parts of the frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RestOfPart {
    /// Where each piece ends along the curve, ascending. The last one is the end of the part.
    #[schema(min_items = 2, max_items = 512)]
    pub ends: Vec<u32>,
    /// Work of each piece: of the first one as measured, of the others as forecast.
    #[schema(min_items = 2, max_items = 512)]
    pub work: Vec<u64>,
}

/// A finished part of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FinishedPart {
    /// Finished pixels.
    Pixels(PartPixels),
    /// A share of the samples.
    Samples(SampleShare),
}

/// Pixels of a part, for the task that puts the image together or divides the frame for the next pass.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PartPixels {
    /// The file with these pixels.
    pub hash: ArtifactHash,
    /// Number of pixels.
    pub count: u32,
    /// Cost of these pixels alone, or of what one pass adds to them.
    pub cost: Spent,
}

impl FinishedPart {
    /// The file.
    pub const fn hash(&self) -> ArtifactHash {
        match self {
            FinishedPart::Pixels(pixels) => pixels.hash,
            FinishedPart::Samples(share) => share.hash,
        }
    }
}

pub(crate) fn one() -> u32 {
    1
}

pub(crate) fn is_one(parts: &u32) -> bool {
    *parts == 1
}

pub(crate) fn is_first(part: &u32) -> bool {
    *part == 0
}
