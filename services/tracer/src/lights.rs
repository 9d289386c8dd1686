//! Light sources, and the sampling of points on them.
//!
//! | file | subject |
//! | --- | --- |
//! | `luminaires` | area lights by object and material; if there are few, every point samples all of them |
//! | `emitters` | lights with a position, one by one, for any number of them |
//! | `tree`, `bounds` | the light tree that chooses among emitters, and the bounds of its nodes |
//! | `selection` | chooses one light out of all, including the environment and the suns |

mod bounds;
mod emitters;
mod luminaires;
mod selection;
mod tree;

pub use bounds::Receiver;
pub use emitters::Emitter;
pub use luminaires::Luminaires;
pub use selection::{Light, Lights};
pub use tree::Choice;

use crate::bounds::Bounds;
use crate::geometry;
use forelight_bvh::{Hit, size_of};
use forelight_scene::Geometry;
use glam::{Vec2, Vec3};

/// Largest number of lights with a position (emissive objects and points) that a point seen by the camera
/// samples. The best number is √(b v / (c w)). Here b and c are the times of a camera sample without lights
/// and of a light sample. The variance of a light sample is v, that of a camera sample with known light w.
/// This is 2 to 8 in most rooms, and the minimum is flat.
const SEEN: u32 = 4;

/// Largest number of light samples at any point.
pub const MOST_LOOKS: usize = SEEN as usize;

/// Number of lights with a position that a point samples, chosen by the light tree. `None` means all lights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Looks {
    /// At points that the camera sees, directly or via mirrors and glass.
    pub seen: Option<u32>,
    /// At points that gathered rays hit. There are hundreds of these per gather, so the noise averages out.
    pub gathered: Option<u32>,
}

impl Looks {
    /// The numbers for a scene with `count` lights.
    pub fn new(count: usize) -> Self {
        let some = |looks: u32| (count > looks as usize).then_some(looks);
        Self { seen: some(SEEN), gathered: some(1) }
    }

    /// The number at a point after `level` diffuse bounces.
    pub fn at(self, level: u32) -> Option<u32> {
        if level == 0 { self.seen } else { self.gathered }
    }
}

/// An emitting triangle, with everything that sampling it needs.
#[derive(Debug, Clone, Copy)]
struct Surface {
    triangle: u32,
    /// Index of its material in the frame.
    material: u32,
    corners: [Vec3; 3],
    /// See [`size_of`].
    size: f32,
    /// Unit geometric normal, on the side from which the triangle is counter-clockwise.
    normal: Vec3,
}

/// A sampled point on an emitting triangle.
pub struct LightPoint {
    pub position: Vec3,
    /// Largest coordinate of the triangle's corners.
    pub size: f32,
    /// Unit geometric normal, on the side from which the triangle is counter-clockwise.
    pub normal: Vec3,
    /// Index of the triangle's material in the frame.
    pub material: u32,
    /// The point as a ray hit.
    pub hit: Hit,
}

/// Chooses a part of a light from cumulative shares, for `u` in [0, 1), and the position in it in [0, 1].
fn part(cumulative: &[f32], u: f32) -> (usize, f32) {
    let i = cumulative.partition_point(|&c| c <= u).min(cumulative.len() - 1);
    let below = if i == 0 { 0.0 } else { cumulative[i - 1] };
    let within = ((u - below) / (cumulative[i] - below)).clamp(0.0, 1.0);
    (i, if within.is_nan() { 0.5 } else { within })
}

/// Cumulative shares of areas. The last one is 1.
fn cumulative(areas: impl Iterator<Item = f64> + Clone) -> impl Iterator<Item = f32> {
    let total: f64 = areas.clone().sum();
    areas.scan(0.0, move |sum, area| {
        *sum += area;
        Some((*sum / total) as f32)
    })
}

/// Whether a point is closer to a light's box than the light is wide. There, sampling by area misses the few
/// points that matter, and directions from the surface have to help.
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

    /// A uniform point on the triangle.
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
