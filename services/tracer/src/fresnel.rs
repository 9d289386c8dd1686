//! How much an interface reflects.

use glam::Vec3;

/// What a ray meets at a smooth dielectric interface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interface {
    /// Reflectance of unpolarised light, in [0, 1].
    pub reflectance: f32,
    /// Cosine of the refracted direction with the normal on the other side; 0 under total internal reflection.
    pub cos_t: f32,
}

/// Fresnel equations of a dielectric for `cos_i` ≥ 0 and `eta` = (index on the other side) / (index on this side).
/// 1 − cos² is computed as (1 − c)(1 + c), which keeps its digits near normal incidence.
pub fn dielectric(cos_i: f32, eta: f32) -> Interface {
    let cos_i = cos_i.clamp(0.0, 1.0);
    if eta == 1.0 {
        return Interface { reflectance: 0.0, cos_t: cos_i }; // no contrast; the quotients below would be 0/0 at grazing
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

/// Schlick's approximation for a conductor of normal reflectance `f0` (Schlick 1994).
pub fn conductor(cos_i: f32, f0: Vec3) -> Vec3 {
    let x = 1.0 - cos_i.clamp(0.0, 1.0);
    let x2 = x * x;
    f0 + (Vec3::ONE - f0) * (x2 * x2 * x)
}

/// Reflectance of a pane with two parallel faces, all inter-reflections summed: 2R / (1 + R).
pub fn pane(cos_i: f32, ior: f32) -> f32 {
    let r = dielectric(cos_i, ior).reflectance;
    2.0 * r / (1.0 + r)
}

/// Share of diffuse light inside a dielectric that its surface throws back inside: 1 − (1 − F̄) / η², with F̄ the
/// mean reflectance from outside, 2 ∫ F(c) c dc, by the midpoint rule in c².
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
        // At Brewster's angle tan θ = η only the perpendicular half remains: ((1 − η²)/(1 + η²))² / 2.
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
