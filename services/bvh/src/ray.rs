//! Rays, hits, and the count of traversal steps.

use glam::Vec3;

/// A ray, from `t_min` to `t_max`. `direction` need not be normalised; distances are in units of its length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Start point, in metres.
    pub origin: Vec3,
    /// Direction: finite and not zero. The inverse of its largest component must be finite.
    pub direction: Vec3,
    /// Hits at `t <= t_min` do not count.
    pub t_min: f32,
    /// Hits at `t > t_max` do not count.
    pub t_max: f32,
}

impl Ray {
    /// A ray from `origin` to infinity.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
    }
}

/// A point where a ray meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Ray parameter of the hit.
    pub t: f32,
    /// Triangle index, as passed to [`crate::Bvh::build`].
    pub primitive: u32,
    /// Barycentric weight of the second corner.
    pub u: f32,
    /// Barycentric weight of the third corner.
    pub v: f32,
}

impl Hit {
    /// The position of the hit, from the triangle's corners. Its error is a few ulps of their coordinates,
    /// whatever the length of the ray (Wächter and Binder 2019, "A Fast and Robust Method for Avoiding
    /// Self-Intersection").
    pub fn position(&self, [a, b, c]: [Vec3; 3]) -> Vec3 {
        (1.0 - self.u - self.v) * a + self.u * b + self.v * c
    }
}

/// Deterministic counts of traversal steps, and scratch memory that queries reuse.
#[derive(Debug, Clone, Default)]
pub struct Traversal {
    /// Number of nodes visited. Each visit tests eight boxes.
    pub nodes: u64,
    /// Number of triangle tests. Each tested group counts as four.
    pub triangles: u64,
    pub(crate) stack: Vec<Entry>,
    pub(crate) children: Vec<u32>,
}

/// A subtree on the traversal stack, and the distance at which the ray enters it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Entry {
    pub near: f32,
    pub child: u32,
}

/// Moves `point` off its surface along the unit `normal`, so that a ray from there does not hit that surface
/// again.
///
/// The step is 2⁻¹⁸ of `size`, the largest coordinate of the triangle's corners ([`size_of`]): 32 to 64 ulps.
/// Points from barycentrics are off by a few ulps (Wächter and Binder 2019). The step contains no length in
/// metres, so scaling a scene by a power of two keeps all mantissas.
pub fn offset_origin(point: Vec3, normal: Vec3, size: f32) -> Vec3 {
    const STEP: f32 = 1.0 / 262_144.0;
    point + normal * (size * STEP)
}

/// The largest absolute coordinate of a triangle's corners.
pub fn size_of([a, b, c]: [Vec3; 3]) -> f32 {
    a.abs().max(b.abs()).max(c.abs()).max_element()
}
