//! The pixel counts of a frame, as its preview shows them.

use serde::{Deserialize, Serialize};

use crate::error::ForecastError;
use crate::strata::{Stratum, check};

/// The preview of one frame, as pixel counts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FramePopulation {
    /// The frame's number, which is also its time. Strictly increasing, gaps allowed.
    pub number: i64,
    /// Number of pixels of each stratum, N_h.
    pub counts: Vec<u32>,
    /// Number of the set of shining lights. Costs depend on the lights, and no preview shows them.
    pub lights: u32,
    /// Number of shining lights. Unit costs under any lights are closer to each other than to those in the
    /// dark.
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
