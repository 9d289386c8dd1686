//! Why frames are dear.

use crate::StratumName;
use serde::{Deserialize, Serialize};

/// What a quote's work goes into, and what would halve it. Work is that of all frames, as the quote expects it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Explanation {
    /// The whole.
    pub work: f64,
    /// Kinds of work, the dearest first.
    pub parts: Vec<PartShare>,
    /// The pixels' part by what they show, the dearest first; those of little work are not listed.
    pub objects: Vec<ObjectShare>,
    /// Rays by what sends them out, the most first.
    pub rays: Vec<RayShare>,
    /// Ways to halve the whole; none where what no pixel can help is more than half of it.
    pub halving: Vec<Halving>,
}

/// A kind of work.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct PartShare {
    /// What it is.
    pub part: String,
    /// Its work.
    pub work: f64,
    /// Its share of the whole, 0 to 1.
    pub share: f64,
}

/// Pixels that show one material of one object.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct ObjectShare {
    /// What they show; absent of the background.
    pub shows: Option<StratumName>,
    /// How many they are, in all frames.
    pub pixels: u64,
    /// Share of all pixels, 0 to 1.
    pub share_of_pixels: f64,
    /// Their work.
    pub work: f64,
    /// Its share of the whole, 0 to 1.
    pub share: f64,
    /// Work of one of them over that of the mean pixel.
    pub times_mean_pixel: f64,
}

/// Rays of one category.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct RayShare {
    /// Its name.
    pub category: String,
    /// How many are expected.
    pub rays: f64,
    /// Share of all rays, 0 to 1.
    pub share: f64,
}

/// A setting that would halve the whole.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Halving {
    /// Name of the setting.
    pub setting: String,
    /// Its value now.
    pub from: f64,
    /// The value that would do.
    pub to: f64,
}
