//! The rays of the `ambient` integrator, with the state of their path.

use super::{Passed, Point, leaving};
use crate::lights::Receiver;
use forelight_bvh::Ray;
use glam::Vec3;

/// The lights that a ray sees when it hits them.
#[derive(Debug, Clone, Copy)]
pub enum Arrival {
    /// All lights: from the camera or a mirror that it sees. After a diffuse bounce: only the environment.
    Everything,
    /// None: the diffuse surface at its origin has sampled them.
    Nothing,
    /// Only the environment: the surface at its origin has sampled the other lights, or ignores them.
    Sky,
    /// Area lights, weighted by the density of the direction per steradian; `receiver` is the glossy surface.
    Shared { receiver: Receiver, density: f32 },
}

/// A ray and the state of its path.
#[derive(Debug, Clone, Copy)]
pub struct Segment {
    pub(super) ray: Ray,
    /// The last surface that the ray has passed straight through.
    pub(super) passed: Option<Passed>,
    pub(super) arrival: Arrival,
    /// Number of diffuse bounces so far.
    pub(super) level: u32,
    /// Number of mirror, glass and glossy hits since the last diffuse bounce.
    pub(super) depth: u32,
    /// Number of hits so far. It selects the dimension of the random numbers.
    pub(super) vertex: u32,
    /// Largest channel of this ray's contribution to the pixel.
    pub(super) weight: f32,
}

impl Segment {
    /// The same ray, behind a surface that it passes straight.
    #[inline]
    pub(super) fn beyond(&self, passed: Passed) -> Self {
        Self { passed: Some(passed), vertex: self.vertex + 1, ..*self }
    }

    /// A ray from a point in another direction.
    #[inline]
    pub(super) fn turned(&self, p: &Point, direction: Vec3, arrival: Arrival) -> Self {
        let (depth, vertex) = (self.depth + 1, self.vertex + 1);
        Self { ray: leaving(p, direction), passed: None, arrival, depth, vertex, ..*self }
    }
}
