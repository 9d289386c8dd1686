//! Rays, hits, and the count of traversal steps.

use glam::Vec3;

/// A ray, from `t_min` to `t_max`. `direction` need not be normalised; distances are in units of its length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Start point, in metres.
    pub origin: Vec3,
    /// Direction. It must be finite and not zero, and the inverse of its largest component must be finite.
    /// Any component may be zero of either sign.
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
    /// The position of the hit, computed from the triangle's corners instead of along the ray.
    ///
    /// Its error is then a few ulps of the corners' coordinates, whatever the length of the ray (Wächter and
    /// Binder 2019, "A Fast and Robust Method for Avoiding Self-Intersection").
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
/// `size` is the largest coordinate of the triangle's corners ([`size_of`]). It bounds the rounding error of
/// a point between them. Points from barycentrics are off by a few ulps of the corners (Wächter and Binder
/// 2019); the step is 2⁻¹⁸ of `size`, which is 32 to 64 ulps.
///
/// Unlike the step of Wächter and Binder, ours contains no length in metres. A scene scaled by a power of two
/// therefore has rays with the same mantissas, and the step is as small as the corners allow.
pub fn offset_origin(point: Vec3, normal: Vec3, size: f32) -> Vec3 {
    const STEP: f32 = 1.0 / 262_144.0;
    point + normal * (size * STEP)
}

/// The largest absolute coordinate of a triangle's corners.
pub fn size_of([a, b, c]: [Vec3; 3]) -> f32 {
    a.abs().max(b.abs()).max(c.abs()).max_element()
}
