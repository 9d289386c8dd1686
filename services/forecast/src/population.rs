//! The pixel counts of a frame, as its preview shows them.

use serde::{Deserialize, Serialize};

use crate::error::ForecastError;
use crate::strata::{Stratum, check};

/// The preview of one frame, as pixel counts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FramePopulation {
    /// The frame's number, which is also its time. Numbers increase strictly from frame to frame. Gaps are
    /// allowed.
    pub number: i64,
    /// Number of pixels of each stratum, N_h.
    pub counts: Vec<u32>,
    /// The set of shining lights, as a number. Frames with the same set have the same number. The cost of a
    /// surface depends on the lights, and no preview shows them.
    pub lights: u32,
    /// Number of shining lights. A unit cost under one set of lights is closer to that under another set than
    /// to that in the dark.
    pub shining: u32,
    /// Triangles of the frame, visible or not. They determine the cost of building the tree. 0 if unknown.
    pub triangles: u64,
}

/// Checks that frames are in order, and that their counts match the strata.
pub(crate) fn check_frames(strata: &[Stratum], frames: &[FramePopulation]) -> Result<(), ForecastError> {
    for frame in frames {
        check(strata, frame.number, &frame.counts)?;
    }
    match frames.windows(2).find(|pair| pair[0].number >= pair[1].number) {
        Some(pair) => Err(ForecastError::FrameOrder { frame: pair[1].number }),
        None => Ok(()),
    }
}
