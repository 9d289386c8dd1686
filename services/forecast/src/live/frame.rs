//! A frame of a running job.

use super::band::Band;

/// What is known of a frame's true cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Known {
    /// Nothing is finished.
    Nothing,
    /// A part of the frame is finished.
    Part {
        /// Finished pixels over all pixels, 0 to 1.
        share: f64,
        /// Cost of the finished pixels.
        cost: f64,
    },
    /// The frame is finished, at this cost.
    All(f64),
}

/// A frame of the job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiveFrame {
    /// Time on the shot's own clock, from [`crate::shot_times`].
    pub time: f64,
    /// The set of shining lights, as a number. Frames with the same set have the same number.
    pub lights: u32,
    /// The quoted cost.
    pub quote: Band,
    /// What is known of the true cost.
    pub known: Known,
}
