//! Videos of a job's finished frames.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{ArtifactHash, FrameState, JobId, Spent};

/// Most frames of a video.
pub const VIDEO_FRAMES: u64 = 20_000;

/// Most bytes of a video.
pub const VIDEO_BYTES: u64 = 1 << 30;

/// Frames per second, such as 24 or 23.976. Rounded to thousandths.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(try_from = "f64", into = "f64")]
#[schema(value_type = f64, minimum = 1, maximum = 240)]
pub struct FrameRate(u32);

impl FrameRate {
    /// Of films, and of scenes that state none.
    pub const FILM: Self = Self(24_000);

    /// Thousandths of a frame per second.
    pub const fn thousandths(self) -> u32 {
        self.0
    }
}

impl TryFrom<f64> for FrameRate {
    type Error = String;

    fn try_from(rate: f64) -> Result<Self, String> {
        // This form also refuses a NaN.
        if (1.0..=240.0).contains(&rate) {
            return Ok(Self((rate * 1000.0).round() as u32));
        }
        Err(format!("{rate} frames per second; a video has 1 to 240"))
    }
}

impl From<FrameRate> for f64 {
    fn from(rate: FrameRate) -> Self {
        Self::from(rate.0) / 1000.0
    }
}

impl FromStr for FrameRate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let rate: f64 = text.parse().map_err(|_| format!("{text:?} is not a number of frames per second"))?;
        rate.try_into()
    }
}

impl fmt::Display for FrameRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f64::from(*self).fmt(f)
    }
}

/// A video that is made of a job's frames when the last of them is finished.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VideoRequest {
    /// Frames per second. If absent, those of the scene, or 24.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_per_second: Option<FrameRate>,
}

/// The video of a job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobVideo {
    /// Frames per second.
    pub frames_per_second: FrameRate,
    /// `waiting` until the last frame is finished, `ready` until a node takes it, `leased` while it is encoded,
    /// `done` when it is there, `failed` after all attempts, `cancelled` if its job ended otherwise.
    pub state: FrameState,
    /// How far it is, 0 to 1: half for fetching the images, half for encoding them.
    pub progress: f64,
    /// The file: MP4 with H.264. Absent until it is done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<VideoFile>,
    /// Why it failed. Absent if it did not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// Why no node takes it. Absent if one may.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<String>,
}

/// The file of a video.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VideoFile {
    /// Its hash.
    pub hash: ArtifactHash,
    /// Its size in bytes.
    pub bytes: u64,
    /// Number of its frames.
    pub frames: u32,
}

/// Task: encode the finished frames of a job as a video.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct VideoSpec {
    /// The job.
    pub job_id: JobId,
    /// Frames per second.
    pub frames_per_second: FrameRate,
    /// The images as PNG files, in order.
    pub pictures: Vec<ArtifactHash>,
}

/// Result of encoding a video.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VideoResult {
    /// The video.
    pub file: VideoFile,
    /// Cost of the task.
    pub spent: Spent,
    /// Largest resident memory of the encoder in bytes. 0 if unknown.
    #[serde(default)]
    pub peak_memory_bytes: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_a_number_in_json_and_keeps_its_thousandths() {
        for (text, thousandths) in [("24", 24_000), ("23.976", 23_976), ("59.94", 59_940), ("240", 240_000)] {
            let rate: FrameRate = serde_json::from_str(text).unwrap();
            assert_eq!((rate.thousandths(), rate.to_string()), (thousandths, text.to_owned()));
            assert_eq!(text.parse(), Ok(rate));
            assert_eq!(
                serde_json::from_value::<FrameRate>(serde_json::to_value(rate).unwrap()).unwrap(),
                rate
            );
        }
        for wrong in ["0", "0.9", "241", "-24", "1e99", "null", "\"24\""] {
            assert!(serde_json::from_str::<FrameRate>(wrong).is_err(), "{wrong}");
        }
        assert!("NaN".parse::<FrameRate>().is_err());
    }
}
