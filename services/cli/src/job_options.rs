//! Flags of several commands that say what a job, or a frame, is to come to.

use clap::ValueEnum;
use std::path::PathBuf;

/// How sure a booking, or what a frame comes to, has to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ConfidenceLevel {
    /// As likely missed as kept.
    P50,
    /// Kept four times out of five.
    P80,
    /// Kept nineteen times out of twenty.
    P95,
}

impl From<ConfidenceLevel> for forelight_protocol::Confidence {
    fn from(level: ConfidenceLevel) -> Self {
        match level {
            ConfidenceLevel::P50 => Self::P50,
            ConfidenceLevel::P80 => Self::P80,
            ConfidenceLevel::P95 => Self::P95,
        }
    }
}

/// Whether the frames of a job share one irradiance cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Sharing {
    /// Whatever takes less work; the quote has both prices.
    Auto,
    /// One is made for all frames before any is rendered.
    Shared,
    /// Every frame makes its own.
    Private,
}

impl From<Sharing> for forelight_protocol::CacheSharing {
    fn from(sharing: Sharing) -> Self {
        match sharing {
            Sharing::Auto => Self::Auto,
            Sharing::Shared => Self::Shared,
            Sharing::Private => Self::Private,
        }
    }
}

/// A picture to write.
pub fn png_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(end) if end.eq_ignore_ascii_case("png") => Ok(path),
        _ => Err("it will be a PNG, so the name must end in .png".into()),
    }
}
