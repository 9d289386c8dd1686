//! Orthonormal frames, and maps from the unit square to discs, hemispheres and other domains.

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// An orthonormal frame whose third axis is a given normal.
#[derive(Debug, Clone, Copy)]
pub struct Basis {
    tangent: Vec3,
    bitangent: Vec3,
    pub normal: Vec3,
}

impl Basis {
    /// The frame of a unit normal (Duff et al. 2017, "Building an Orthonormal Basis, Revisited").
    pub fn new(normal: Vec3) -> Self {
        let sign = 1f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
            bitangent: Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
            normal,
        }
    }

    pub fn to_world(self, local: Vec3) -> Vec3 {
        local.x * self.tangent + local.y * self.bitangent + local.z * self.normal
    }

    pub fn to_local(self, world: Vec3) -> Vec3 {
        Vec3::new(world.dot(self.tangent), world.dot(self.bitangent), world.dot(self.normal))
    }
}

/// Maps the unit square to the unit disc, preserving area (Shirley and Chiu 1997, concentric map).
pub fn disc(u: Vec2) -> Vec2 {
    let p = 2.0 * u - 1.0;
    if p == Vec2::ZERO {
        return Vec2::ZERO;
    }
    let (radius, angle) = if p.x.abs() > p.y.abs() {
        (p.x, FRAC_PI_4 * (p.y / p.x))
    } else {
        (p.y, FRAC_PI_2 - FRAC_PI_4 * (p.x / p.y))
    };
    // Rust's libm gives the same bits on every machine.
    Vec2::new(radius * libm::cosf(angle), radius * libm::sinf(angle))
}

/// Direction about +z with density cos θ / π.
pub fn cosine_hemisphere(u: Vec2) -> Vec3 {
    let p = disc(u);
    p.extend((1.0 - p.length_squared()).max(0.0).sqrt())
}

/// Uniform direction in the cone about +z whose half-angle has cosine 1 − `height`.
pub fn cap(u: Vec2, height: f32) -> Vec3 {
    let p = disc(u);
    let r2 = p.length_squared();
    let z = 1.0 - r2 * height;
    // sin θ = sqrt((1 − z)(1 + z)), mapped to a disc of radius 1.
    (p * (height * (2.0 - r2 * height)).max(0.0).sqrt()).extend(z)
}

/// Barycentric weights of a uniform point (Heitz 2019, "A Low-Distortion Map Between Triangle and Square").
pub fn triangle(u: Vec2) -> (f32, f32) {
    if u.y > u.x {
        let b = u.x * 0.5;
        (b, u.y - b)
    } else {
        let c = u.y * 0.5;
        (u.x - c, c)
    }
}

/// Coordinates in a latitude-longitude image: centre −z, top row +y, u grows to the right.
pub fn direction_to_lat_long(d: Vec3) -> Vec2 {
    let u = libm::atan2f(d.x, -d.z) / (2.0 * PI) + 0.5;
    let v = libm::acosf(d.y.clamp(-1.0, 1.0)) / PI;
    Vec2::new(u, v)
}

/// Inverse of [`direction_to_lat_long`]. Also returns the sine of the polar angle.
pub fn lat_long_to_direction(uv: Vec2) -> (Vec3, f32) {
    let (phi, theta) = ((uv.x - 0.5) * 2.0 * PI, uv.y * PI);
    let (sin_theta, cos_theta) = (libm::sinf(theta), libm::cosf(theta));
    (Vec3::new(libm::sinf(phi) * sin_theta, cos_theta, -libm::cosf(phi) * sin_theta), sin_theta)
}
