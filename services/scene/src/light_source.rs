//! The lights of `scene.json`.

use crate::animation::Animated;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A light from `scene.json`. Metres; `radiance` in W/(m² sr), `intensity` in W/sr, `irradiance` in W/m².
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum LightSource {
    /// It emits on one side, towards `edge_u` × `edge_v`.
    Quad {
        corner: DVec3,
        edge_u: DVec3,
        edge_v: DVec3,
        radiance: Animated<DVec3>,
    },
    Point {
        position: DVec3,
        intensity: Animated<DVec3>,
    },
    /// `direction` is towards the sun.
    Sun {
        direction: DVec3,
        irradiance: Animated<DVec3>,
        angle_deg: f64,
    },
}
