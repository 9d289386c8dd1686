//! The explanation of a quote.

use crate::StratumName;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Where the expected work of a quote, or of one of its frames, goes, and what would halve it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Explanation {
    /// The explanation in words, a sentence each, the most important first.
    pub words: Vec<String>,
    /// The frame that is explained. Absent if all frames are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// All work, without building an irradiance cache that frames share.
    pub work: f64,
    /// Kinds of work, the largest first.
    pub parts: Vec<PartShare>,
    /// Work of the pixels by what they show, the largest first. Shares below 1 % are not listed.
    pub objects: Vec<ObjectShare>,
    /// Rays by category, those that cause the most work first.
    pub rays: Vec<RayShare>,
    /// Share of the whole that one more camera sample in every pixel costs.
    pub camera_sample: f64,
    /// Settings that would halve the work. Empty if no single setting can.
    pub halving: Vec<Halving>,
}

/// A kind of work.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PartShare {
    /// Its name.
    pub part: String,
    /// Its work.
    pub work: f64,
    /// Its share of the whole, 0 to 1.
    pub share: f64,
}

/// Pixels that show one material of one object.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ObjectShare {
    /// Object and material. Absent for the background.
    pub shows: Option<StratumName>,
    /// Number of these pixels in all frames.
    pub pixels: u64,
    /// Share of all pixels, 0 to 1.
    pub share_of_pixels: f64,
    /// Work of these pixels.
    pub work: f64,
    /// Share of the whole work, 0 to 1.
    pub share: f64,
    /// Work of one of these pixels over that of the mean pixel.
    pub times_mean_pixel: f64,
    /// How many of these pixels were profiled.
    pub samples: u64,
    /// Share of the whole work per profiled pixel, 0 to 1. Absent if none was profiled and similar pixels
    /// stand in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share_per_sample: Option<f64>,
}

impl ObjectShare {
    /// Object and material as text.
    pub fn name(&self) -> String {
        self.shows
            .as_ref()
            .map_or("the background".into(), |name| format!("{}, {}", name.object, name.material))
    }
}

/// Rays of one category.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct RayShare {
    /// Name of the category.
    pub category: String,
    /// Expected number of rays.
    pub rays: f64,
    /// Share of all rays, 0 to 1.
    pub share: f64,
    /// Work that these rays cause; see [`crate::RenderStats::work_by_ray`]. Absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work: Option<f64>,
    /// Share of the whole work, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share_of_work: Option<f64>,
}

/// A setting that would halve the work.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Halving {
    /// Name of the setting. If it is the width, the height changes in proportion.
    pub setting: String,
    /// The present value.
    pub from: f64,
    /// The value that halves the work.
    pub to: f64,
}
