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
pub use tree::{Choice, Receiver};

use crate::bounds::Bounds;
use crate::geometry;
use forelight_bvh::{Hit, size_of};
use forelight_scene::Geometry;
use glam::{Vec2, Vec3};

/// So many lights with a position (objects that emit, and points) a point that the camera sees looks at, at most. The error that a
/// given time leaves is least at √(b v / (c w)) looks (b: time of a camera sample without looks, c: of a look, v: variance of a look,
/// w: of a camera sample that knows its light): 2 to 8 in most rooms, and flat around it.
const SEEN: u32 = 4;

/// The most looks of any point.
pub const MOST_LOOKS: usize = SEEN as usize;

/// How many of the lights with a position a point looks at, chosen by the light tree; `None` where it looks at all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Looks {
    /// Points that the camera sees, also by mirrors and through glass.
    pub seen: Option<u32>,
    /// Points that a gathered ray meets: one of hundreds, over which chance evens out.
    pub gathered: Option<u32>,
}

impl Looks {
    /// Looks at `count` lights.
    pub fn new(count: usize) -> Self {
        let some = |looks: u32| (count > looks as usize).then_some(looks);
        Self { seen: some(SEEN), gathered: some(1) }
    }

    /// Looks of a point after so many diffuse bounces.
    pub fn at(self, level: u32) -> Option<u32> {
        if level == 0 { self.seen } else { self.gathered }
    }
}

/// An emitting triangle, with what every look at it needs.
#[derive(Debug, Clone, Copy)]
struct Surface {
    triangle: u32,
    /// Index of its material in the frame.
    material: u32,
    corners: [Vec3; 3],
    /// See [`size_of`].
    size: f32,
    /// Unit geometric normal by the winding.
    normal: Vec3,
}

/// A point chosen on an emitting triangle.
pub struct LightPoint {
    pub position: Vec3,
    /// Largest coordinate of the triangle's corners.
    pub size: f32,
    /// Unit geometric normal by the winding.
    pub normal: Vec3,
    /// Index of the triangle's material in the frame.
    pub material: u32,
    /// The same as something that a ray could have met.
    pub hit: Hit,
}

/// The part of a light that `u` in [0, 1) falls into, by the cumulative shares of its parts, and where in it, in [0, 1].
fn part(cumulative: &[f32], u: f32) -> (usize, f32) {
    let i = cumulative.partition_point(|&c| c <= u).min(cumulative.len() - 1);
    let below = if i == 0 { 0.0 } else { cumulative[i - 1] };
    let within = ((u - below) / (cumulative[i] - below)).clamp(0.0, 1.0);
    (i, if within.is_nan() { 0.5 } else { within })
}

/// Cumulative shares of areas; the last one is 1.
fn cumulative(areas: impl Iterator<Item = f64> + Clone) -> impl Iterator<Item = f32> {
    let total: f64 = areas.clone().sum();
    areas.scan(0.0, move |sum, area| {
        *sum += area;
        Some((*sum / total) as f32)
    })
}

/// Whether a point is closer to a light's box than the light is wide. There, points chosen by area miss the few that matter (their
/// weight grows like 1/distance²), and directions chosen by the surface have to help.
fn is_near(light: &Bounds, area: f32, point: Vec3) -> bool {
    let outside = (light.low - point).max(point - light.high).max(Vec3::ZERO);
    outside.length_squared() < area
}

impl Surface {
    fn of(geometry: &Geometry, triangle: u32) -> Self {
        let corners = geometry.corners(triangle);
        Self {
            triangle,
            material: geometry.material(triangle),
            corners,
            size: size_of(corners),
            normal: geometry.geometric_normal(triangle),
        }
    }

    /// A uniform point of it.
    fn point(&self, u: Vec2) -> LightPoint {
        let (u, v) = geometry::triangle(u);
        let hit = Hit { t: 0.0, primitive: self.triangle, u, v };
        LightPoint {
            position: hit.position(self.corners),
            size: self.size,
            normal: self.normal,
            material: self.material,
            hit,
        }
    }
}
