//! Errors in the input of a forecast.

/// Why no forecast can be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ForecastError {
    /// Nothing was measured.
    #[error("no pixel was profiled, so there is nothing to base a forecast on")]
    NoSamples,
    /// A prior cost is not positive and finite.
    #[error("stratum {stratum}: the prior cost must be positive and finite")]
    BadPriorCost {
        /// Index of the stratum.
        stratum: usize,
    },
    /// An observation or a pixel names a stratum that does not exist.
    #[error("unknown stratum {stratum}: there are only {strata} strata")]
    UnknownStratum {
        /// The index named.
        stratum: u32,
        /// Number of strata.
        strata: usize,
    },
    /// A frame does not have exactly one pixel count for each stratum.
    #[error("frame {frame}: {counts} pixel counts for {strata} strata")]
    CountsLength {
        /// The frame's number.
        frame: i64,
        /// Number of its counts.
        counts: usize,
        /// Number of strata.
        strata: usize,
    },
    /// More pixels of a stratum were profiled than the preview shows.
    #[error("stratum {stratum}: {samples} pixels profiled, but the preview shows {pixels}")]
    MoreSamplesThanPixels {
        /// Index of the stratum.
        stratum: usize,
        /// Number of profiled pixels.
        samples: u64,
        /// Number of pixels in the preview.
        pixels: u64,
    },
    /// The pixels do not fill whole rows.
    #[error("{pixels} pixels do not make whole rows of width {width}")]
    ImageShape {
        /// Number of pixels.
        pixels: usize,
        /// Width of a row.
        width: u32,
    },
    /// Frame numbers do not increase strictly.
    #[error("frame {frame} comes after a frame with the same or a greater number")]
    FrameOrder {
        /// The offending frame's number.
        frame: i64,
    },
    /// A profiled frame is not a frame of the shot, or is given twice.
    #[error("profiled frame index {index} is not a frame of the shot, or is given twice")]
    ProfiledFrame {
        /// Index into the shot's frames.
        index: usize,
    },
    /// A frame has no line in its samples.
    #[error("frame {frame}: its cost was not measured at two different numbers of samples")]
    NoSampleLine {
        /// The frame's number.
        frame: i64,
    },
    /// The areas of [`Expansion::Areas`](crate::Expansion::Areas) do not match the observations or the frame.
    #[error(
        "{areas} areas with {covered} pixels do not match {observations} observations of a frame with {pixels} pixels"
    )]
    Areas {
        /// Number of areas.
        areas: usize,
        /// Sum of the areas, in pixels.
        covered: u64,
        /// Number of observations.
        observations: usize,
        /// Number of pixels of the frame.
        pixels: u64,
    },
}
