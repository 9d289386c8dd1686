//! The functions of a kernel. `kernel` composes the table for a frame; the integrators call it.

use super::queries::Shadow;
use super::{Interface, Passed, Pixels, Point, Segment};
use crate::cost::Counters;
use crate::response::Response;
use crate::tracer::Tracer;
use forelight_bvh::{Hit, Ray};
use glam::Vec3;

/// Light that reaches a point from one kind of light. The last argument is the path vertex.
pub type Light = fn(&mut Pixels<'_>, &Point, &Response, u32) -> Vec3;

/// Indirect diffuse light at a point, without the lights that are sampled directly.
pub type Ambient = fn(&mut Pixels<'_>, &Segment, &Point, &Response) -> Vec3;

/// The interface that a ray meets at the face of a solid dielectric.
pub type AtInterface = fn(&mut Pixels<'_>, &Ray, &Hit, &Point) -> Interface;

/// The functions of a frame's kernel.
#[derive(Clone)]
pub struct Kernel {
    /// Creates the ray of a camera sample, from the pixel's column and row.
    pub camera: fn(&mut Pixels<'_>, u32, u32) -> Ray,
    /// Light from each kind of point, area or distant light, at points seen from the camera.
    pub lights: Vec<Light>,
    /// The same, at points met by gathered rays.
    pub gathered_lights: Vec<Light>,
    /// Light from the environment.
    pub sky: Option<Light>,
    /// Indirect diffuse light.
    pub ambient: Option<Ambient>,
    /// Interfaces of solid dielectrics, with or without priorities.
    pub interface: AtInterface,
    /// Radiance along a camera ray.
    pub integrate: fn(&mut Pixels<'_>, Ray) -> Vec3,
    /// The first hit of a ray, behind what it has already passed.
    pub closest: fn(&Tracer, &Ray, Option<Passed>, &mut Counters) -> Option<Hit>,
    /// What a shadow ray meets.
    pub shadow: fn(&Tracer, &Ray, &mut Counters) -> Shadow,
    /// Whether some surfaces have more than the diffuse lobe.
    pub several_lobes: bool,
    /// A kernel without lights that finds the points at which the cache will be read.
    pub probe: Option<Box<Kernel>>,
}
