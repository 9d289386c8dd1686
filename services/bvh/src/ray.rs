//! Rays, hits, and the count of what finding them took.

use glam::Vec3;

/// A half-line, or a piece of one. `direction` need not be normalised; distances are in units of its length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Start.
    pub origin: Vec3,
    /// Direction, finite and not zero; the inverse of its largest component is finite too. Any component may be zero of either sign.
    pub direction: Vec3,
    /// Hits at this parameter or before it do not count.
    pub t_min: f32,
    /// Hits beyond this parameter do not count.
    pub t_max: f32,
}

impl Ray {
    /// A ray without an end.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
    }
}

/// Where a ray meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Ray parameter.
    pub t: f32,
    /// Triangle index as given to [`crate::Bvh::build`].
    pub primitive: u32,
    /// Barycentric weight of the second corner.
    pub u: f32,
    /// Barycentric weight of the third corner.
    pub v: f32,
}

impl Hit {
    /// The point hit, from the triangle's corners rather than along the ray: its error is then a few ulps of
    /// the corners' size whatever the length of the ray (Wächter and Binder 2019).
    pub fn position(&self, [a, b, c]: [Vec3; 3]) -> Vec3 {
        (1.0 - self.u - self.v) * a + self.u * b + self.v * c
    }
}

/// Deterministic count of traversal steps, and the scratch memory that queries reuse.
#[derive(Debug, Clone, Default)]
pub struct Traversal {
    /// Nodes visited; in each, eight boxes are tested.
    pub nodes: u64,
    /// Triangle tests, counted in the lanes of the groups of four that were tested.
    pub triangles: u64,
    pub(crate) stack: Vec<Entry>,
    pub(crate) children: Vec<u32>,
}

/// A subtree still to be visited, and where the ray enters it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Entry {
    pub near: f32,
    pub child: u32,
}

/// Moves `point` off its surface along the unit normal `normal`, by a few ulps of each coordinate, so that a ray
/// from there does not meet the surface that it starts on, at any scale of scene.
///
/// Wächter and Binder, "A Fast and Robust Method for Avoiding Self-Intersection", Ray Tracing Gems (2019), chapter 6,
/// with their constants.
pub fn offset_origin(point: Vec3, normal: Vec3) -> Vec3 {
    const ORIGIN: f32 = 1.0 / 32.0;
    const FLOAT_SCALE: f32 = 1.0 / 65536.0;
    const INT_SCALE: f32 = 256.0;
    let component = |p: f32, n: f32| {
        if p.abs() < ORIGIN {
            p + FLOAT_SCALE * n
        } else {
            let ulps = (INT_SCALE * n) as i32;
            f32::from_bits((p.to_bits() as i32).wrapping_add(if p < 0.0 { -ulps } else { ulps }) as u32)
        }
    };
    Vec3::new(component(point.x, normal.x), component(point.y, normal.y), component(point.z, normal.z))
}
