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

/// Moves `point` off its surface along the unit normal `normal`, so that a ray from there does not meet the surface that it starts
/// on. `size` is the largest coordinate of the triangle's corners ([`size_of`]), on which the rounding of a point
/// between them depends.
///
/// Points from barycentrics are off by a few units in the last place of the corners (Wächter and Binder 2019); 2⁻¹⁸ of their size is 32
/// to 64 of these units. Unlike Wächter and Binder's, the step has no length in metres in it: a scene that is scaled by a power of two
/// has rays of the same bits, and the step is as small as the corners allow.
pub fn offset_origin(point: Vec3, normal: Vec3, size: f32) -> Vec3 {
    const STEP: f32 = 1.0 / 262_144.0;
    point + normal * (size * STEP)
}

/// The largest absolute coordinate of a triangle's corners.
pub fn size_of([a, b, c]: [Vec3; 3]) -> f32 {
    a.abs().max(b.abs()).max(c.abs()).max_element()
}
