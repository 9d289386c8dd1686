//! Camera samples that differ by pixel.

use std::sync::Arc;

/// Number of camera samples of each pixel, in row-major order. Each is at least 1.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampleCounts(Arc<[u16]>);

/// Why sample counts are invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SampleCountsError {
    /// Their number differs from the number of pixels.
    #[error("{found} sample counts for {expected} pixels; one per pixel is needed")]
    Length {
        /// Number of counts.
        found: usize,
        /// Number of pixels in the image.
        expected: usize,
    },
    /// A pixel has no samples, and therefore no colour.
    #[error("pixel {0} has a sample count of 0; it must be at least 1")]
    None(usize),
    /// The image already has other sample counts.
    #[error("the sample counts of this image were already set")]
    Late,
}

impl SampleCounts {
    /// Sample counts for all pixels. Fails if one is 0.
    pub fn new(counts: Vec<u16>) -> Result<Self, SampleCountsError> {
        match counts.iter().position(|&count| count == 0) {
            Some(pixel) => Err(SampleCountsError::None(pixel)),
            None => Ok(Self(counts.into())),
        }
    }

    /// The counts in row-major order.
    pub fn as_slice(&self) -> &[u16] {
        &self.0
    }

    /// The counts as bytes, little-endian, in row-major order.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.0.iter().flat_map(|count| count.to_le_bytes()).collect()
    }

    /// Parses the output of [`Self::to_bytes`]. Fails if one is 0. A half count at the end is left out.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SampleCountsError> {
        let (counts, _) = bytes.as_chunks();
        Self::new(counts.iter().copied().map(u16::from_le_bytes).collect())
    }

    /// The counts, if their number is `expected`.
    pub(crate) fn for_pixels(&self, expected: usize) -> Result<&[u16], SampleCountsError> {
        match self.0.len() {
            found if found == expected => Ok(&self.0),
            found => Err(SampleCountsError::Length { found, expected }),
        }
    }

    /// The larger of the two counts, pixel by pixel. Both must be for the same pixels.
    #[must_use]
    pub fn or_more(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(other.0.iter()).map(|(own, other)| *own.max(other)).collect())
    }

    /// Smallest and largest count, and the mean.
    pub fn range(&self) -> (u32, u32, f64) {
        let all = || self.0.iter().copied().map(u32::from);
        let sum: u64 = all().map(u64::from).sum();
        (all().min().unwrap_or(0), all().max().unwrap_or(0), sum as f64 / self.0.len().max(1) as f64)
    }
}
