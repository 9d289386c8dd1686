//! Where light comes from, and how to choose points of it.
//!
//! | file | subject |
//! | --- | --- |
//! | `luminaires` | area lights by object and material: where there are few, all are sampled |
//! | `emitters` | lights with a position, one by one, for any number of them |
//! | `tree`, `bounds` | the tree by which one of the emitters is chosen; what its nodes know of their lights |
//! | `selection` | one light out of everything that shines, the sky and the suns included |

mod bounds;
mod emitters;
mod luminaires;
mod selection;
mod tree;

pub use emitters::Emitter;
pub use luminaires::Luminaires;
pub use selection::{Light, Lights};
pub use tree::Receiver;

use crate::geometry;
use forelight_bvh::{Hit, size_of};
use forelight_scene::Frame;
use glam::{Vec2, Vec3};

/// Up to so many lights with a position (objects that emit, and points), every point that is lit looks at each. Of more it
/// looks at so many, chosen by a tree.
pub const FEW: usize = 8;

/// A point chosen on an emitting triangle.
pub struct LightPoint {
    pub position: Vec3,
    /// Largest coordinate of the triangle's corners.
    pub size: f32,
    /// Unit geometric normal by the winding.
    pub normal: Vec3,
    pub uv: Vec2,
    /// The same as something that a ray could have met.
    pub hit: Hit,
}

impl LightPoint {
    /// A uniform point of a triangle.
    fn on(frame: &Frame, triangle: u32, u: Vec2) -> Self {
        let (b, c) = geometry::triangle(u);
        let hit = Hit { t: 0.0, primitive: triangle, u: b, v: c };
        let corners = frame.geometry.corners(triangle);
        Self {
            size: size_of(corners),
            position: hit.position(frame.geometry.corners(triangle)),
            normal: frame.geometry.geometric_normal(triangle),
            uv: frame.geometry.uv(triangle, b, c),
            hit,
        }
    }
}
