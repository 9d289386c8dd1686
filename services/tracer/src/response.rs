//! Reflection of a material at a point, prepared for light sampling.

use crate::fresnel;
use crate::microfacet as ggx;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// The part of a surface's reflection that light sampling can find. Local directions, +z on the viewer's
/// side.
#[derive(Debug, Clone, Copy)]
pub struct Response {
    /// Lambertian reflectance.
    pub diffuse: Vec3,
    /// The coat that light passes on its way in and out.
    pub coat: Option<Coat>,
    /// The glossy lobe.
    pub glossy: Option<Glossy>,
}

/// Smooth dielectric coat over a Lambertian base.
#[derive(Debug, Clone, Copy)]
pub struct Coat {
    /// Index of refraction.
    pub ior: f32,
    /// Internal diffuse reflectance; see [`fresnel::internal_diffuse`].
    pub internal: f32,
}

impl Coat {
    /// Fraction of light that the coat lets in at an angle of cosine `cos`.
    pub fn passes(self, cos: f32) -> f32 {
        1.0 - fresnel::dielectric(cos, self.ior).reflectance
    }
}

/// A GGX lobe.
#[derive(Debug, Clone, Copy)]
pub struct Glossy {
    /// GGX alpha, not below [`ggx::SMOOTH`].
    pub alpha: f32,
    /// Reflectance of the microfacets.
    pub fresnel: Tint,
}

/// Fresnel reflectance of a microfacet.
#[derive(Debug, Clone, Copy)]
pub enum Tint {
    /// Conductor with this reflectance at normal incidence.
    Conductor(Vec3),
    /// Dielectric with this index of refraction.
    Dielectric(f32),
}

impl Tint {
    /// Reflectance at an angle of cosine `cos` to the microfacet's normal.
    pub fn reflectance(self, cos: f32) -> Vec3 {
        match self {
            Self::Conductor(f0) => fresnel::conductor(cos, f0),
            Self::Dielectric(ior) => Vec3::splat(fresnel::dielectric(cos, ior).reflectance),
        }
    }
}

impl Response {
    /// The diffuse lobe times π, for light from `wo`: the weight of a cosine-weighted sample. Under a coat,
    /// light enters with 1 − F(wo) and leaves with 1 − F(wi); 1/η² accounts for the larger solid angle
    /// outside. Light that the coat reflects back (the fraction `internal`) is scattered again. So the
    /// material's colour is the reflectance seen from outside.
    pub fn diffuse(&self, wi: Vec3, wo: Vec3) -> Vec3 {
        self.outgoing(wi) * self.coat.map_or(1.0, |coat| coat.passes(wo.z))
    }

    /// The part of [`Self::diffuse`] independent of `wo`: response towards `wi` to light that passed the
    /// coat.
    pub fn outgoing(&self, wi: Vec3) -> Vec3 {
        match self.coat {
            None => self.diffuse,
            Some(coat) => {
                let series = self.diffuse / (1.0 - coat.internal);
                series * (coat.passes(wi.z) / (coat.ior * coat.ior))
            }
        }
    }

    /// Diffuse lobe and glossy lobe for light from `wo` (z > 0), both with the factor cos θₒ, and the density
    /// per steradian of [`Glossy::sample`].
    pub fn evaluate(&self, wi: Vec3, wo: Vec3) -> (Vec3, Vec3, f32) {
        let diffuse = self.diffuse(wi, wo) * (FRAC_1_PI * wo.z);
        let Some(glossy) = self.glossy else { return (diffuse, Vec3::ZERO, 0.0) };
        let h = (wi + wo).normalize_or(Vec3::Z);
        let d = ggx::distribution(h, glossy.alpha);
        let g = ggx::masking_shadowing(wi, wo, glossy.alpha);
        let value = glossy.fresnel.reflectance(wi.dot(h)) * (d * g / (4.0 * wi.z));
        (diffuse, value, ggx::reflected_density(wi, h, glossy.alpha))
    }

    /// Whether there is diffuse reflection, for which lights are sampled and the hemisphere gathered.
    pub fn has_diffuse(&self) -> bool {
        self.diffuse.max_element() > 0.0
    }
}

impl Glossy {
    /// Samples a direction of reflection, with its weight f cos / density and the density per steradian.
    /// `None` if it is below the surface (single scattering only).
    pub fn sample(&self, wi: Vec3, u: Vec2) -> Option<(Vec3, Vec3, f32)> {
        let h = ggx::sample_visible(wi, self.alpha, u);
        let wo = ggx::reflect(wi, h);
        if wo.z <= 0.0 {
            return None;
        }
        // f cos / density = F · G₂(wi, wo) / G₁(wi), which never exceeds 1.
        let g = ggx::masking_shadowing(wi, wo, self.alpha) / ggx::masking(wi, self.alpha);
        let weight = self.fresnel.reflectance(wi.dot(h)) * g;
        Some((wo, weight, ggx::reflected_density(wi, h, self.alpha)))
    }
}
