//! Strata: the pixels that show one material of one object.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Names of a stratum: the pixels that show one material of one object.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StratumName {
    /// Name of the object.
    pub object: String,
    /// Name of the material.
    pub material: String,
}

/// A stratum, identified by `object` and `material`. Names are for display and may repeat. All tasks of a job
/// number objects and materials alike.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Stratum {
    /// Names for display.
    pub name: StratumName,
    /// Number of the object in the scene, below 2³² − 1.
    pub object: u32,
    /// Number of the material in the scene, below 2³² − 1. Small strata of one material are sampled together.
    pub material: u32,
    /// Expected cost of a pixel before measurement, relative to a plain diffuse one (1): above 0, up to
    /// 1,000,000. It also decides which small strata are joined.
    #[schema(exclusive_minimum = 0, maximum = 1_000_000)]
    pub prior_cost: f64,
}

impl Stratum {
    /// The largest prior cost. With it, no sum over an image's pixels comes near the limits of a float.
    pub const HIGHEST_PRIOR_COST: f64 = 1e6;

    /// The pair of object and material.
    pub const fn identity(&self) -> (u32, u32) {
        (self.object, self.material)
    }
}
