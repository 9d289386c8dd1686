//! What can be wrong with the input of a forecast.

/// Why no forecast can be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ForecastError {
    /// Nothing was measured, so nothing can be said.
    #[error("no pixel was profiled, so there is nothing to base a forecast on")]
    NoSamples,
    /// A prior cost is not a positive number.
    #[error("stratum {stratum}: the prior cost must be positive and finite")]
    BadPriorCost {
        /// Index of the stratum.
        stratum: usize,
    },
    /// An observation or pixel names a stratum that does not exist.
    #[error("stratum {stratum} is named, but there are only {strata}")]
    UnknownStratum {
        /// The index that was named.
        stratum: u32,
        /// How many strata there are.
        strata: usize,
    },
    /// A frame's counts are not one number for each stratum.
    #[error("frame {frame}: {counts} pixel counts for {strata} strata")]
    CountsLength {
        /// The frame's number.
        frame: i64,
        /// How many counts it has.
        counts: usize,
        /// How many strata there are.
        strata: usize,
    },
    /// More pixels of a stratum were profiled than the preview saw.
    #[error("stratum {stratum}: {samples} pixels profiled, but the preview shows {pixels}")]
    MoreSamplesThanPixels {
        /// Index of the stratum.
        stratum: usize,
        /// Profiled pixels.
        samples: u64,
        /// Pixels in the preview.
        pixels: u64,
    },
    /// The image of strata is not a whole number of rows.
    #[error("{pixels} pixels do not make whole rows of width {width}")]
    ImageShape {
        /// Number of pixels.
        pixels: usize,
        /// Stated width.
        width: u32,
    },
    /// Frames are not in strictly increasing order of their numbers.
    #[error("frame {frame} comes after a frame with the same or a greater number")]
    FrameOrder {
        /// The offending frame's number.
        frame: i64,
    },
    /// A profiled frame is not a frame of the shot, or is given twice.
    #[error("profiled frame index {index} is unknown or given twice")]
    ProfiledFrame {
        /// Index into the shot's frames.
        index: usize,
    },
    /// Observations that stand for areas do not match these.
    #[error(
        "{areas} areas of {covered} pixels in all for {observations} observations of a frame of {pixels}"
    )]
    Areas {
        /// How many areas there are.
        areas: usize,
        /// Pixels of all of them.
        covered: u64,
        /// How many observations there are.
        observations: usize,
        /// Pixels of the frame.
        pixels: u64,
    },
}
