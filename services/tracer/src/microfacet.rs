//! Isotropic GGX microfacets, in a local frame whose +z is the surface normal.

use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Below this alpha, the lobe is narrower than f32 directions can resolve: a mirror.
pub const SMOOTH: f32 = 1e-3;

/// GGX normal distribution D(h), per steradian (Walter et al. 2007, equation 33), with |h × z|² = x² + y²
/// against cancellation.
pub fn distribution(h: Vec3, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = h.x * h.x + h.y * h.y + a2 * h.z * h.z;
    a2 / (PI * d * d)
}

/// Smith's Λ for direction `w`.
fn lambda(w: Vec3, alpha: f32) -> f32 {
    let cos2 = w.z * w.z;
    if cos2 == 0.0 {
        return f32::INFINITY;
    }
    0.5 * ((1.0 + alpha * alpha * (w.x * w.x + w.y * w.y) / cos2).sqrt() - 1.0)
}

/// Smith's masking function G₁: the fraction of microfacets that are visible from `w`.
pub fn masking(w: Vec3, alpha: f32) -> f32 {
    1.0 / (1.0 + lambda(w, alpha))
}

/// Height-correlated masking and shadowing G₂: fraction visible from both (Heitz 2014, equation 99).
pub fn masking_shadowing(wi: Vec3, wo: Vec3, alpha: f32) -> f32 {
    1.0 / (1.0 + lambda(wi, alpha) + lambda(wo, alpha))
}

/// Samples a microfacet normal visible from `wi` (z > 0), by a uniform point of a spherical cap (Dupuy and
/// Benyoub 2023).
pub fn sample_visible(wi: Vec3, alpha: f32, u: Vec2) -> Vec3 {
    let standard = Vec3::new(wi.x * alpha, wi.y * alpha, wi.z).normalize();
    let phi = 2.0 * PI * u.x;
    let z = (1.0 - u.y) * (1.0 + standard.z) - standard.z;
    let r = ((1.0 - z) * (1.0 + z)).max(0.0).sqrt();
    let half = Vec3::new(r * libm::cosf(phi), r * libm::sinf(phi), z) + standard;
    Vec3::new(half.x * alpha, half.y * alpha, half.z.max(0.0)).normalize_or(Vec3::Z)
}

/// Density per steradian of reflecting `wi` about a normal of [`sample_visible`]: G₁(wi) D(h) / (4 wi.z).
pub fn reflected_density(wi: Vec3, h: Vec3, alpha: f32) -> f32 {
    masking(wi, alpha) * distribution(h, alpha) / (4.0 * wi.z)
}

/// Mirror image of `w` about `n`. Both point away from the surface.
pub fn reflect(w: Vec3, n: Vec3) -> Vec3 {
    2.0 * w.dot(n) * n - w
}

/// Refraction at relative index `eta`. `n` is on the side of `w`; `cos_t` is the cosine of the refracted
/// angle.
pub fn refract(w: Vec3, n: Vec3, eta: f32, cos_t: f32) -> Vec3 {
    let cos_i = w.dot(n);
    ((cos_i / eta - cos_t) * n - w / eta).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Sampler};

    #[test]
    fn visible_normals_project_to_one() {
        // ∫ G₁(w) max(0, w·h) D(h) dh = w.z defines a masking function (Heitz 2014, equation 6).
        for alpha in [0.05f32, 0.3, 0.8] {
            for z in [0.1f32, 0.5, 0.95] {
                let w = Vec3::new((1.0 - z * z).sqrt(), 0.0, z);
                let (nt, np) = (2000, 400);
                let mut sum = 0.0f64;
                for i in 0..nt {
                    // Use smaller steps where D peaks: θ = (π/2) s².
                    let s = (f64::from(i) + 0.5) / f64::from(nt);
                    let theta = (s * s * std::f64::consts::FRAC_PI_2) as f32;
                    let jacobian = std::f64::consts::PI * s;
                    for j in 0..np {
                        let phi = (j as f32 + 0.5) / np as f32 * 2.0 * PI;
                        let h = Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
                        let value = distribution(h, alpha) * w.dot(h).max(0.0) * theta.sin();
                        sum += f64::from(value) * jacobian / f64::from(nt) * 2.0 * std::f64::consts::PI
                            / f64::from(np);
                    }
                }
                let projected = sum * f64::from(masking(w, alpha));
                assert!((projected / f64::from(z) - 1.0).abs() < 5e-3, "alpha {alpha}, z {z}: {projected}");
            }
        }
    }

    #[test]
    fn samples_follow_the_density() {
        // Compares the mean of z over samples with the same mean by quadrature over the reflected density.
        let (alpha, wi) = (0.5f32, Vec3::new(0.6, 0.0, 0.8));
        let mut sampler = Sampler::new(3, 0, 0);
        let n = 65_536;
        let mut by_samples = 0.0f64;
        for _ in 0..n {
            let h = sample_visible(wi, alpha, sampler.next(Purpose::Glossy, 0));
            by_samples += f64::from(reflect(wi, h).z.max(0.0)) / f64::from(n);
        }
        let (nt, np) = (1000, 1000);
        let mut by_quadrature = 0.0f64;
        for i in 0..nt {
            let z = (i as f32 + 0.5) / nt as f32;
            for j in 0..np {
                let phi = (j as f32 + 0.5) / np as f32 * 2.0 * PI;
                let r = (1.0 - z * z).sqrt();
                let wo = Vec3::new(r * phi.cos(), r * phi.sin(), z);
                let h = (wi + wo).normalize();
                by_quadrature += f64::from(reflected_density(wi, h, alpha) * z) * 2.0 * std::f64::consts::PI
                    / f64::from(nt * np);
            }
        }
        assert!((by_samples / by_quadrature - 1.0).abs() < 3e-3, "{by_samples} against {by_quadrature}");
    }
}
