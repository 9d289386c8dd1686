//! The functions of a kernel, and the bits of its const parameter. `kernel` composes the table for a frame;
//! the integrators call it.

use super::{Interface, Pixels, Point, Segment};
use crate::response::Response;
use forelight_bvh::{Hit, Ray};
use glam::Vec3;

/// Bits of a kernel's const parameter.
pub mod has {
    /// Rough reflections are followed.
    pub const GLOSSY: u32 = 1;
    /// Mirrors, panes and solid glass are followed.
    pub const SPECULAR: u32 = 1 << 1;
    /// Some surfaces let light pass straight through: panes and partial opacity.
    pub const PASSING: u32 = 1 << 2;
    /// Some surfaces have a cut-out texture, so every hit must be checked.
    pub const CUT_OUTS: u32 = 1 << 3;
    /// Colours may come from textures.
    pub const TEXTURES: u32 = 1 << 4;
}

/// Light that reaches a point from one kind of light. The last argument is the path vertex.
pub type Light<const K: u32> = fn(&mut Pixels<'_, K>, &Point, &Response, u32) -> Vec3;

/// Indirect diffuse light at a point, without the lights that are sampled directly.
pub type Ambient<const K: u32> = fn(&mut Pixels<'_, K>, &Segment, &Point, &Response) -> Vec3;

/// The interface that a ray meets at the face of a solid dielectric.
pub type AtInterface<const K: u32> = fn(&mut Pixels<'_, K>, &Ray, &Hit, &Point) -> Interface;

/// The functions of a frame's kernel.
#[derive(Clone)]
pub struct Kernel<const K: u32> {
    /// Creates the ray of a camera sample, from the pixel's column and row.
    pub camera: fn(&mut Pixels<'_, K>, u32, u32) -> Ray,
    /// Light from each kind of point, area or distant light, at points seen from the camera.
    pub lights: Vec<Light<K>>,
    /// The same, at points met by gathered rays.
    pub gathered_lights: Vec<Light<K>>,
    /// Light from the environment.
    pub sky: Option<Light<K>>,
    /// Indirect diffuse light.
    pub ambient: Option<Ambient<K>>,
    /// Interfaces of solid dielectrics, with or without priorities.
    pub interface: AtInterface<K>,
    /// Radiance along a camera ray.
    pub integrate: fn(&mut Pixels<'_, K>, Ray) -> Vec3,
    /// A kernel without lights that finds the points at which the cache will be read.
    pub probe: Option<Box<Kernel<K>>>,
}
