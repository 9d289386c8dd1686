//! A material at a point, ready to be lit: what share of light from a direction leaves towards the viewer.

use crate::fresnel;
use crate::microfacet as ggx;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// The part of a surface's reflection that light sampling can find. Directions are local, +z on the viewer's side.
#[derive(Debug, Clone, Copy)]
pub struct Response {
    /// Lambert reflectance.
    pub diffuse: Vec3,
    /// The coat that light has to pass on its way in and out.
    pub coat: Option<Coat>,
    /// The glossy lobe.
    pub glossy: Option<Glossy>,
}

/// Smooth dielectric coat over a Lambert base.
#[derive(Debug, Clone, Copy)]
pub struct Coat {
    /// Index of refraction.
    pub ior: f32,
    /// Share of diffuse light inside that the coat throws back, see [`fresnel::internal_diffuse`].
    pub internal: f32,
}

impl Coat {
    /// Share of light that the coat lets in under an angle of cosine `cos`.
    pub fn passes(self, cos: f32) -> f32 {
        1.0 - fresnel::dielectric(cos, self.ior).reflectance
    }
}

/// A GGX lobe.
#[derive(Debug, Clone, Copy)]
pub struct Glossy {
    /// GGX alpha, not below [`ggx::SMOOTH`].
    pub alpha: f32,
    /// What a microfacet reflects.
    pub fresnel: Tint,
}

/// Reflectance of the microfacets.
#[derive(Debug, Clone, Copy)]
pub enum Tint {
    /// Conductor of this reflectance at normal incidence.
    Conductor(Vec3),
    /// Dielectric of this index of refraction.
    Dielectric(f32),
}

impl Tint {
    /// Reflectance under this cosine with the microfacet's normal.
    pub fn reflectance(self, cos: f32) -> Vec3 {
        match self {
            Self::Conductor(f0) => fresnel::conductor(cos, f0),
            Self::Dielectric(ior) => Vec3::splat(fresnel::dielectric(cos, ior).reflectance),
        }
    }
}

impl Response {
    /// The diffuse lobe times π for light from `wo`: BSDF · π, so that cosine-weighted samples are weighted by it alone.
    ///
    /// Under a coat: light enters with 1 − F(wo), leaves with 1 − F(wi), and 1/η² is the widening of solid angle at the exit;
    /// what the coat throws back inside, the share `internal`, is scattered out again, so that the reflectance that is seen
    /// from outside, and not that of the bare base, is the colour that the material names.
    pub fn diffuse(&self, wi: Vec3, wo: Vec3) -> Vec3 {
        self.outgoing(wi) * self.coat.map_or(1.0, |coat| coat.passes(wo.z))
    }

    /// The part of [`Self::diffuse`] that does not depend on where the light comes from: what leaves towards `wi` of light
    /// that has passed the coat.
    pub fn outgoing(&self, wi: Vec3) -> Vec3 {
        match self.coat {
            None => self.diffuse,
            Some(coat) => {
                let series = self.diffuse / (1.0 - coat.internal);
                series * (coat.passes(wi.z) / (coat.ior * coat.ior))
            }
        }
    }

    /// Both lobes for light from `wo` (z > 0), times cos θₒ, and the density per steradian with which
    /// [`Glossy::sample`] would have chosen `wo`.
    pub fn evaluate(&self, wi: Vec3, wo: Vec3) -> (Vec3, Vec3, f32) {
        let diffuse = self.diffuse(wi, wo) * (FRAC_1_PI * wo.z);
        let Some(glossy) = self.glossy else { return (diffuse, Vec3::ZERO, 0.0) };
        let h = (wi + wo).normalize_or(Vec3::Z);
        let d = ggx::distribution(h, glossy.alpha);
        let g = ggx::masking_shadowing(wi, wo, glossy.alpha);
        let value = glossy.fresnel.reflectance(wi.dot(h)) * (d * g / (4.0 * wi.z));
        (diffuse, value, ggx::reflected_density(wi, h, glossy.alpha))
    }

    /// Whether any light that arrives is lost: nothing to light, nothing to gather.
    pub fn has_diffuse(&self) -> bool {
        self.diffuse.max_element() > 0.0
    }
}

impl Glossy {
    /// A direction of reflection, its weight f cos / density, and the density; `None` if it points below the surface, where
    /// single scattering has nothing to give.
    pub fn sample(&self, wi: Vec3, u: Vec2) -> Option<(Vec3, Vec3, f32)> {
        let h = ggx::sample_visible(wi, self.alpha, u);
        let wo = ggx::reflect(wi, h);
        if wo.z <= 0.0 {
            return None;
        }
        // f cos / density = F · G₂(wi, wo) / G₁(wi), never above 1.
        let g = ggx::masking_shadowing(wi, wo, self.alpha) / ggx::masking(wi, self.alpha);
        let weight = self.fresnel.reflectance(wi.dot(h)) * g;
        Some((wo, weight, ggx::reflected_density(wi, h, self.alpha)))
    }
}
