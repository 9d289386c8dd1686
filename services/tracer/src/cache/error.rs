//! Errors of the cache's file format.

use super::file::MAGIC;

/// Why bytes are not a valid cache, or not one for this frame.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CacheError {
    /// The magic bytes are wrong.
    #[error("not an irradiance cache of this version (it must begin with {}); make it again", MAGIC.escape_ascii())]
    Foreign,
    /// The length differs from what the headers say.
    #[error("truncated irradiance cache: it has {found} bytes instead of {expected}")]
    Length {
        /// Actual number of bytes.
        found: u64,
        /// Number of bytes according to the headers.
        expected: u64,
    },
    /// The checksum is wrong, or a value is out of range.
    #[error("damaged irradiance cache: {0}")]
    Damaged(&'static str),
    /// It was made for another scene or with other settings.
    #[error("the irradiance cache was made for other images ({0}); make it again")]
    OtherScene(
        /// The differences, in words.
        String,
    ),
    /// Parts of different plans cannot be merged.
    #[error("the irradiance caches have different plans; only parts of the same plan can be merged")]
    OtherPlan,
}
