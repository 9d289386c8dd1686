//! Camera samples that differ by pixel.

use std::sync::Arc;

/// Numbers of camera samples, one for each pixel of an image, row by row from the top left; each at least 1.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampleCounts(Arc<[u16]>);

/// Why numbers of camera samples are no good.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SampleCountsError {
    /// There are more or fewer than pixels.
    #[error("{found} numbers of camera samples for {expected} pixels")]
    Length {
        /// Numbers given.
        found: usize,
        /// Pixels of the image.
        expected: usize,
    },
    /// A pixel without samples has no colour.
    #[error("pixel {0} is given no camera sample")]
    None(usize),
    /// Something was traced with others before.
    #[error("the image's camera samples have been laid down already")]
    Late,
}

impl SampleCounts {
    /// Numbers for all pixels.
    ///
    /// # Errors
    /// If one of them is 0.
    pub fn new(counts: Vec<u16>) -> Result<Self, SampleCountsError> {
        match counts.iter().position(|&count| count == 0) {
            Some(pixel) => Err(SampleCountsError::None(pixel)),
            None => Ok(Self(counts.into())),
        }
    }

    /// The numbers.
    pub fn as_slice(&self) -> &[u16] {
        &self.0
    }

    /// The numbers, if they are for so many pixels.
    pub(crate) fn for_pixels(&self, expected: usize) -> Result<&[u16], SampleCountsError> {
        match self.0.len() {
            found if found == expected => Ok(&self.0),
            found => Err(SampleCountsError::Length { found, expected }),
        }
    }

    /// Each number or, where it is larger, that of `other`; both are for the same pixels.
    #[must_use]
    pub fn or_more(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(other.0.iter()).map(|(own, other)| *own.max(other)).collect())
    }

    /// Fewest and most of a pixel, and their mean.
    pub fn range(&self) -> (u32, u32, f64) {
        let all = || self.0.iter().copied().map(u32::from);
        let sum: u64 = all().map(u64::from).sum();
        (all().min().unwrap_or(0), all().max().unwrap_or(0), sum as f64 / self.0.len().max(1) as f64)
    }
}
