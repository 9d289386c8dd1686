//! Fresnel reflectance of interfaces.

use glam::Vec3;

/// Reflectance and refraction at a smooth dielectric interface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interface {
    /// Reflectance of unpolarised light, in [0, 1].
    pub reflectance: f32,
    /// Cosine of the angle of refraction; 0 for total internal reflection.
    pub cos_t: f32,
}

/// Fresnel equations of a dielectric. `cos_i` ≥ 0 is the cosine of the angle of incidence, `eta` the index of
/// refraction on the other side over that on this side. 1 − cos² is (1 − c)(1 + c), which is precise near
/// normal incidence.
pub fn dielectric(cos_i: f32, eta: f32) -> Interface {
    let cos_i = cos_i.clamp(0.0, 1.0);
    if eta == 1.0 {
        // no interface; the quotients below would be 0/0 at grazing angles
        return Interface { reflectance: 0.0, cos_t: cos_i };
    }
    let sin2_t = (1.0 - cos_i) * (1.0 + cos_i) / (eta * eta);
    if sin2_t >= 1.0 {
        return Interface { reflectance: 1.0, cos_t: 0.0 };
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    let reflectance = 0.5 * (parallel * parallel + perpendicular * perpendicular);
    Interface { reflectance: reflectance.min(1.0), cos_t }
}

/// Schlick's approximation for a conductor with reflectance `f0` at normal incidence (Schlick 1994).
pub fn conductor(cos_i: f32, f0: Vec3) -> Vec3 {
    let x = 1.0 - cos_i.clamp(0.0, 1.0);
    let x2 = x * x;
    f0 + (Vec3::ONE - f0) * (x2 * x2 * x)
}

/// Reflectance of a pane with two parallel faces, including all inter-reflections: 2R / (1 + R).
pub fn pane(cos_i: f32, ior: f32) -> f32 {
    let r = dielectric(cos_i, ior).reflectance;
    2.0 * r / (1.0 + r)
}

/// Internal diffuse reflectance of a dielectric: the fraction of diffuse light inside that its surface
/// reflects back, 1 − (1 − F̄) / η². The mean reflectance from outside, F̄ = 2 ∫ F(c) c dc, is integrated by
/// the midpoint rule in c².
pub fn internal_diffuse(ior: f32) -> f32 {
    const STEPS: u32 = 512;
    let mean: f64 = (0..STEPS)
        .map(|i| f64::from(dielectric(((i as f32 + 0.5) / STEPS as f32).sqrt(), ior).reflectance))
        .sum::<f64>()
        / f64::from(STEPS);
    let ior = f64::from(ior);
    (1.0 - (1.0 - mean) / (ior * ior)).clamp(0.0, 0.999) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_incidence_and_brewster_match_the_closed_forms() {
        assert!((dielectric(1.0, 1.5).reflectance - 0.04).abs() < 1e-7);
        // At Brewster's angle, tan θ = η, only the perpendicular component remains: ((1 − η²)/(1 + η²))² / 2.
        let eta = 1.5f64;
        let expected = ((1.0 - eta * eta) / (1.0 + eta * eta)).powi(2) / 2.0;
        let cos = (1.0 / (1.0 + eta * eta)).sqrt() as f32;
        assert!((f64::from(dielectric(cos, 1.5).reflectance) - expected).abs() < 1e-6);
    }

    #[test]
    fn total_internal_reflection_starts_at_the_critical_angle() {
        let critical = (1.0f32 - 1.0 / 2.25).sqrt();
        assert_eq!(dielectric(critical - 1e-4, 1.0 / 1.5).reflectance, 1.0);
        assert!(dielectric(critical + 1e-4, 1.0 / 1.5).reflectance < 1.0);
    }

    #[test]
    fn an_interface_without_contrast_reflects_nothing() {
        for cos in [0.0, 1e-7, 0.5, 1.0] {
            assert_eq!(dielectric(cos, 1.0).reflectance, 0.0);
        }
    }

    #[test]
    fn internal_diffuse_reflectance_matches_the_literature() {
        // 0.596 for η = 1.5 (Egan and Hilgeman 1973).
        assert!((internal_diffuse(1.5) - 0.596).abs() < 2e-3, "{}", internal_diffuse(1.5));
    }
}
