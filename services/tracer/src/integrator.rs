//! The integrators, and what they share: camera rays, surface points, and ray queries.
//!
//! | file | subject |
//! | --- | --- |
//! | `ambient`, `segment` | distribution ray tracing with gathered indirect light; its rays |
//! | `cached` | indirect light from the irradiance cache; the rays that plan and fill it |
//! | `direct` | direct light |
//! | `features` | what camera rays show first, for denoisers |
//! | `path` | unbiased path tracing |
//! | `interface` | the two sides of a solid dielectric's face |
//! | `table` | the functions of a kernel, which the integrators call |
//! | `secondary` | indirect light by way of small bright places |
//! | `occlusion` | shadow rays: what is between a point and a light |
//! | `queries` | what rays meet in the BVH |

mod ambient;
mod cached;
mod direct;
mod features;
mod interface;
mod occlusion;
mod path;
mod queries;
mod secondary;
mod segment;
mod table;

pub use interface::Interface;
pub use segment::Segment;
pub use table::{Ambient, Kernel, Light};

use crate::cache::Site;
use crate::cost::{Category, Counters};
use crate::geometry::{self, Basis};
use crate::lights::Receiver;
use crate::media::Media;
use crate::random::{Drawn, Purpose, Sampler};
use crate::tracer::Tracer;
use forelight_bvh::{Hit, Ray, offset_origin, size_of};
use forelight_scene::{Color, Sun};
use glam::{Vec2, Vec3};

/// A point on a surface, seen from where the ray came from.
pub struct Point {
    position: Vec3,
    /// Largest coordinate of the triangle's corners.
    size: f32,
    /// Unit geometric normal, on the side from which the triangle is counter-clockwise.
    geometric: Vec3,
    /// Shading frame. Its normal is on the viewer's side.
    basis: Basis,
    /// Unit direction to the viewer, in world space and in the shading frame.
    viewer: Vec3,
    wi: Vec3,
    uv: Vec2,
    material: usize,
    stratum: u32,
    primitive: u32,
    /// Distance from the ray's origin.
    distance: f32,
}

/// The last surface that a ray has passed straight through. The ray continues as the same ray, so it meets
/// every face exactly once, in the order of distance and triangle index.
#[derive(Debug, Clone, Copy)]
pub struct Passed {
    t: f32,
    primitive: u32,
}

impl Passed {
    /// The ray from here on. Hits at the same distance must be held against [`Self::is_before`].
    fn rest(self, ray: &Ray) -> Ray {
        Ray { t_min: self.t.next_down(), ..*ray }
    }

    fn is_before(self, hit: &Hit) -> bool {
        hit.t > self.t || hit.t == self.t && hit.primitive > self.primitive
    }
}

impl From<&Hit> for Passed {
    fn from(hit: &Hit) -> Self {
        Self { t: hit.t, primitive: hit.primitive }
    }
}

impl Point {
    /// Marks this point as passed.
    fn passed(&self) -> Passed {
        Passed { t: self.distance, primitive: self.primitive }
    }

    /// The point as a receiver for light selection, for a surface that reflects.
    fn receiver(&self) -> Receiver {
        Receiver { position: self.position, normal: Some(self.basis.normal) }
    }
}

/// Traces one pixel with a kernel.
pub struct Pixels<'a> {
    tracer: &'a Tracer,
    kernel: &'a Kernel,
    sampler: Sampler,
    /// The solids that contain the origin of the current ray.
    media: Media,
    pub counters: Counters,
    /// Stratum that the current camera ray met first.
    pub met: Option<u32>,
    /// The sites at which a probe would have read the cache.
    pub sites: Vec<Site>,
}

impl<'a> Pixels<'a> {
    pub fn new(tracer: &'a Tracer, kernel: &'a Kernel, sampler: Sampler) -> Self {
        Self {
            tracer,
            kernel,
            sampler,
            media: Media::default(),
            counters: Counters::default(),
            met: None,
            sites: Vec::new(),
        }
    }

    /// Key of the pixel's random numbers.
    pub fn key(&self) -> u64 {
        self.sampler.key()
    }

    /// Stores how far its random sequences are drawn.
    pub fn note_drawn(&self, drawn: &mut Drawn) {
        self.sampler.note_drawn(drawn);
    }

    /// Traces one camera sample of the pixel at column `x` and row `y`. Returns its radiance.
    pub fn sample(&mut self, x: u32, y: u32) -> Vec3 {
        let ray = (self.kernel.camera)(self, x, y);
        self.counters.ray(Category::Primary);
        self.media = self.tracer.camera_media;
        self.met = None;
        (self.kernel.integrate)(self, ray)
    }

    /// Runs `act`, and attributes its work to rays of a category; see [`crate::cost::WorkByRay`].
    #[inline]
    fn caused_by<T>(&mut self, category: Category, act: impl FnOnce(&mut Self) -> T) -> T {
        let before = self.counters.caused_by(category);
        let given = act(self);
        self.counters.back_to(before);
        given
    }

    /// Direction of a camera ray. It is not normalised: it ends in the plane at distance 1.
    fn camera_direction(&mut self, x: u32, y: u32) -> Vec3 {
        let jitter = self.sampler.next(Purpose::Pixel, 0);
        self.tracer.frame.camera.direction(Vec2::new(x as f32, y as f32) + jitter)
    }

    pub fn through_pinhole(&mut self, x: u32, y: u32) -> Ray {
        let direction = self.camera_direction(x, y);
        Ray::new(self.tracer.frame.camera.origin, direction.normalize())
    }

    pub fn through_lens(&mut self, x: u32, y: u32) -> Ray {
        let camera = &self.tracer.frame.camera;
        if camera.aperture_radius <= 0.0 {
            return self.through_pinhole(x, y);
        }
        let direction = self.camera_direction(x, y);
        let lens = geometry::disc(self.sampler.next(Purpose::Lens, 0)) * camera.aperture_radius;
        let focus = camera.origin + direction * camera.focus_distance;
        let origin = camera.origin + lens.x * camera.right + lens.y * camera.up;
        Ray::new(origin, (focus - origin).normalize())
    }

    /// The first hit of a ray, behind what it has already passed.
    fn closest(&mut self, ray: &Ray, passed: Option<Passed>) -> Option<Hit> {
        (self.kernel.closest)(self.tracer, ray, passed, &mut self.counters)
    }

    fn point(&self, ray: &Ray, hit: &Hit) -> Point {
        let geometry = &self.tracer.frame.geometry;
        let corners = geometry.corners(hit.primitive);
        let position = hit.position(corners);
        let geometric = geometry.geometric_normal(hit.primitive);
        let [a, b, c] = geometry.at_corners(hit.primitive, &geometry.normals);
        let shading = if a == Vec3::ZERO || b == Vec3::ZERO || c == Vec3::ZERO {
            geometric
        } else {
            ((1.0 - hit.u - hit.v) * a + hit.u * b + hit.v * c).normalize_or(geometric)
        };
        let viewer = -ray.direction;
        let side = if shading.dot(viewer) < 0.0 { -1.0 } else { 1.0 };
        let basis = Basis::new(shading * side);
        let mut wi = basis.to_local(viewer);
        wi.z = wi.z.max(1e-6); // avoids a division by zero in the glossy lobe at exactly grazing angles
        let stratum = geometry.triangle_stratum[hit.primitive as usize];
        Point {
            position,
            size: size_of(corners),
            geometric,
            basis,
            viewer,
            wi,
            uv: geometry.uv(hit.primitive, hit.u, hit.v),
            material: geometry.strata.pairs[stratum as usize].1 as usize,
            stratum,
            primitive: hit.primitive,
            distance: hit.t,
        }
    }

    fn color(&mut self, color: &Color, uv: Vec2) -> Vec3 {
        match color.texture {
            Some(texture) => {
                self.counters.texels += 1;
                color.factor * self.tracer.frame.textures[texture.0 as usize].color(uv)
            }
            None => color.factor,
        }
    }
}

/// A ray from the point in `direction`, offset from the surface to that side.
fn leaving(p: &Point, direction: Vec3) -> Ray {
    Ray::new(off_surface(p.position, p.geometric, p.size, direction), direction)
}

/// Offsets a surface point to the side that `direction` points to. `normal` is the geometric normal.
fn off_surface(position: Vec3, normal: Vec3, size: f32, direction: Vec3) -> Vec3 {
    offset_origin(position, if normal.dot(direction) < 0.0 { -normal } else { normal }, size)
}

/// A sun's radiance times its solid angle, W/m². A disc of radiance L with angular radius θ has the solid
/// angle 2π (1 − cos θ). Suns are specified by the irradiance π L sin² θ on a surface that faces them.
fn fluence(sun: &Sun) -> Vec3 {
    sun.irradiance * (2.0 / (2.0 - cap_height(sun.angle_deg)))
}

/// 1 − cos θ, where θ is half the angular diameter, without cancellation: 2 sin²(θ/2).
fn cap_height(angle_deg: f32) -> f32 {
    let s = libm::sinf(angle_deg.to_radians() * 0.25);
    2.0 * s * s
}
