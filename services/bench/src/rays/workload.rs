//! Draws the rays to measure from a seed: the rays of a renderer, the same on every machine.

use forelight_bvh::{Bvh, Ray, Traversal, offset_origin, size_of};
use forelight_random::hash;
use forelight_scene::{Environment, Frame, Geometry};
use glam::{Vec2, Vec3};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Query {
    Closest,
    Any,
}

#[derive(Debug, Clone)]
pub struct RaySet {
    pub name: &'static str,
    pub query: Query,
    /// In the order of the image's pixels, as a renderer asks.
    pub rays: Vec<Ray>,
}

/// Draws about `count` rays of every kind:
///
/// | kind | from | to | query |
/// | --- | --- | --- | --- |
/// | `primary` | the camera | a random point of each pixel, row by row | closest |
/// | `bounce 1` | the hit of a primary ray | cosine-weighted about the normal | closest |
/// | `bounce 3` | the third surface of such a path | cosine-weighted about the normal | closest |
/// | `shadow` | the hit of a primary ray | a point on a light, or else the sky | any |
/// | `occlusion` | the hit of a primary ray | cosine-weighted about the normal | any |
///
/// Every surface counts as opaque and diffuse. A path that leaves the scene has no further rays, so later
/// kinds may have fewer.
pub fn workload(frame: &Frame, bvh: &Bvh, count: u32, seed: u64) -> Vec<RaySet> {
    let geometry = &*frame.geometry;
    let lights = Lights::new(frame);
    let (mut primary, mut shadow, mut bounces) =
        (Vec::new(), Vec::new(), [Vec::new(), Vec::new(), Vec::new()]);
    // An image of the camera's shape with about as many pixels as rays.
    let shape = f64::from(frame.camera.tan_half_x) / f64::from(frame.camera.tan_half_y);
    let height = (f64::from(count) / shape).sqrt().round().clamp(1.0, f64::from(count.max(1))) as u32;
    let width = (count / height).max(1);
    let camera = frame.camera.resized(width, height);
    let mut steps = Traversal::default();
    for pixel in 0..width * height {
        let random = |dimension: u64| unit_square(seed, pixel, dimension);
        let at = Vec2::new((pixel % width) as f32, (pixel / width) as f32) + random(0);
        let mut ray = Ray::new(camera.origin, camera.direction(at).normalize());
        primary.push(ray);
        for (bounce, rays) in bounces.iter_mut().enumerate() {
            let Some(hit) = bvh.closest(&ray, |_| true, &mut steps) else { break };
            let facing = geometry.geometric_normal(hit.primitive);
            let normal = if facing.dot(ray.direction) > 0.0 { -facing } else { facing };
            let corners = geometry.corners(hit.primitive);
            let origin = offset_origin(hit.position(corners), normal, size_of(corners));
            if bounce == 0 {
                shadow.push(lights.towards(geometry, origin, random(8), random(9)));
            }
            ray = Ray::new(origin, cosine_about(normal, random(1 + bounce as u64)));
            rays.push(ray);
        }
    }
    let [first, _, third] = bounces;
    vec![
        RaySet { name: "primary", query: Query::Closest, rays: primary },
        RaySet { name: "bounce 1", query: Query::Closest, rays: first.clone() },
        RaySet { name: "bounce 3", query: Query::Closest, rays: third },
        RaySet { name: "shadow", query: Query::Any, rays: shadow },
        RaySet { name: "occlusion", query: Query::Any, rays: first },
    ]
}

struct Lights {
    /// Emitting triangles, with cumulative areas.
    triangles: Vec<u32>,
    areas: Vec<f64>,
    points: Vec<Vec3>,
    suns: Vec<Vec3>,
    sky: bool,
}

impl Lights {
    fn new(frame: &Frame) -> Self {
        let geometry = &*frame.geometry;
        let mut area = 0.0;
        let (mut triangles, mut areas) = (Vec::new(), Vec::new());
        for triangle in 0..geometry.triangles.len() as u32 {
            if frame.materials[geometry.material(triangle) as usize].is_emissive() {
                let [a, b, c] = geometry.corners(triangle).map(|p| p.as_dvec3());
                area += (b - a).cross(c - a).length();
                triangles.push(triangle);
                areas.push(area);
            }
        }
        Self {
            triangles,
            areas,
            points: frame.points.iter().map(|light| light.position).collect(),
            suns: frame.suns.iter().map(|sun| sun.direction).collect(),
            sky: frame.environment != Environment::Black,
        }
    }

    /// A ray towards one of the lights, chosen uniformly: all surfaces together, the sky, each point and each
    /// sun.
    fn towards(&self, geometry: &Geometry, origin: Vec3, choice: Vec2, place: Vec2) -> Ray {
        let surfaces = usize::from(!self.triangles.is_empty());
        let known = surfaces + self.points.len() + self.suns.len();
        // A scene without lights is treated as if under a sky.
        let sky = usize::from(self.sky || known == 0);
        let mut chosen = (choice.x * (known + sky) as f32) as usize;
        if chosen < surfaces {
            let wanted = f64::from(choice.y) * self.areas.last().copied().unwrap_or(0.0);
            let index = self.areas.partition_point(|&area| area <= wanted).min(self.triangles.len() - 1);
            let [a, b, c] = geometry.corners(self.triangles[index]);
            let root = place.x.sqrt();
            return up_to(origin, a * (1.0 - root) + b * (root * (1.0 - place.y)) + c * (root * place.y));
        }
        chosen -= surfaces;
        if let Some(&point) = self.points.get(chosen) {
            return up_to(origin, point);
        }
        match self.suns.get(chosen - self.points.len()) {
            Some(&direction) => Ray::new(origin, direction),
            None => Ray::new(origin, sphere(place)),
        }
    }
}

/// The segment from `origin` to just before `target`. Its direction is not normalised.
fn up_to(origin: Vec3, target: Vec3) -> Ray {
    let direction = target - origin;
    // The shading point may lie on the light.
    let direction = if direction == Vec3::ZERO { Vec3::Y } else { direction };
    Ray { t_max: 0.9999, ..Ray::new(origin, direction) }
}

/// Cosine-weighted direction about a unit normal: towards a uniform point of the unit sphere that touches the
/// surface. The sphere is slightly smaller, so that there is always a direction.
fn cosine_about(normal: Vec3, random: Vec2) -> Vec3 {
    (normal + 0.9999 * sphere(random)).normalize()
}

/// Uniform point of the unit sphere.
fn sphere(random: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * f64::from(random.x);
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let angle = std::f64::consts::TAU * f64::from(random.y);
    Vec3::new((radius * libm::cos(angle)) as f32, (radius * libm::sin(angle)) as f32, z as f32)
}

/// A point of the unit square: a hash of the arguments.
fn unit_square(seed: u64, pixel: u32, dimension: u64) -> Vec2 {
    let bits = hash(hash(seed ^ dimension << 48) ^ u64::from(pixel));
    let unit = |bits: u64| (bits & 0xff_ffff) as f32 / (1 << 24) as f32;
    Vec2::new(unit(bits), unit(bits >> 32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_scene::{Limits, Scene};

    fn corridor(count: u32, seed: u64) -> Vec<RaySet> {
        let bundle = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/scenes/corridor");
        let frame = Scene::load(bundle.as_ref(), &Limits::default()).unwrap().frame(0).unwrap();
        let bvh = Bvh::build(&frame.geometry.positions, &frame.geometry.triangles);
        workload(&frame, &bvh, count, seed)
    }

    #[test]
    fn the_seed_alone_decides_about_the_rays() {
        let (one, same, other) = (corridor(300, 1), corridor(300, 1), corridor(300, 2));
        for ((one, same), other) in one.iter().zip(&same).zip(&other) {
            assert_eq!(one.rays, same.rays);
            assert_ne!(one.rays, other.rays);
            assert!(one.rays.len() > 200 && one.rays.len() <= 300, "{}: {}", one.name, one.rays.len());
        }
    }

    #[test]
    fn directions_are_cosine_weighted_about_the_normal() {
        let normal = Vec3::new(0.36, 0.48, -0.8);
        let cosines: Vec<f64> =
            (0..20_000).map(|i| f64::from(cosine_about(normal, unit_square(7, i, 0)).dot(normal))).collect();
        // The cosine c has density 2c, so the mean of c is 2/3 and that of c² is 1/2.
        let mean = |power: i32| cosines.iter().map(|c| c.powi(power)).sum::<f64>() / cosines.len() as f64;
        assert!(cosines.iter().all(|&c| c > 0.0));
        assert!((mean(1) - 2.0 / 3.0).abs() < 0.005, "{}", mean(1));
        assert!((mean(2) - 0.5).abs() < 0.007, "{}", mean(2));
    }
}
