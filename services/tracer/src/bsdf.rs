//! Bidirectional scattering distribution functions (BSDFs): how a surface scatters light at one point.
//!
//! Directions are unit vectors away from the surface, in a frame whose +z is the shading normal on the
//! viewer's side. `wi` points to the viewer (z > 0), `wo` to where light comes from: z > 0 reflected, z < 0
//! transmitted. With ρ for the BSDF and θₒ for the angle of `wo`:
//! * [`Bsdf::evaluate`] is ρ(wi, wo) |cos θₒ|, per channel.
//! * [`Bsdf::density`] is the density per steradian with which [`Bsdf::sample`] chooses `wo`.
//! * [`Bsdf::sample`] chooses `wo`. It returns the lobe and the weight ρ |cos θₒ| / density.
//!
//! Evaluation and density leave out delta functions: perfect mirrors and smooth or straight transmission.
//!
//! Radiance that enters a medium of relative index η is divided by η², and multiplied by η² on the way out.
//! So ρ(wi, wo) η² of an interface is symmetric when the sides are exchanged.

use crate::geometry;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

use crate::fresnel;
use crate::microfacet as ggx;
pub use crate::response::{Coat, Glossy, Response, Tint};

/// An interface whose relative index differs from 1 by less than this does not refract, however rough it is.
const CONTRAST: f32 = 1e-3;

/// The BSDF of a material at a point.
#[derive(Debug, Clone, Copy)]
pub enum Bsdf {
    /// Lambertian base, bare or coated, with an optional glossy lobe. A coat without one is a perfect mirror.
    Opaque(Response),
    /// Smooth conductor with this reflectance at normal incidence.
    Mirror(Vec3),
    /// Pane without thickness, with two parallel smooth faces.
    Pane {
        /// Index of refraction of the glass.
        ior: f32,
        /// Fraction of light transmitted, per channel.
        transmittance: Vec3,
    },
    /// Interface of a solid dielectric.
    Glass {
        /// Index of refraction beyond the interface, relative to the viewer's side.
        eta: f32,
        /// Fraction of light transmitted, per channel.
        transmittance: Vec3,
        /// GGX alpha. Below [`crate::microfacet::SMOOTH`] the interface is smooth.
        alpha: f32,
    },
}

/// The lobe from which a direction was sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lobe {
    /// Lambertian reflection.
    Diffuse,
    /// Rough reflection from a metal or a coat.
    Glossy,
    /// Reflection from a mirror, a pane, smooth or rough glass.
    Reflection,
    /// Refraction into the medium beyond the interface.
    Refraction,
    /// Straight transmission through a pane.
    Straight,
}

/// A sampled direction.
#[derive(Debug, Clone, Copy)]
pub struct Scattering {
    /// Direction towards the incoming light, local.
    pub direction: Vec3,
    /// ρ |cos θₒ| / density. For delta functions: the fraction of light over the probability of the choice.
    pub weight: Vec3,
    /// [`Bsdf::density`] of the direction. `None` for delta functions, which no other technique can find.
    pub density: Option<f32>,
    /// The sampled lobe.
    pub lobe: Lobe,
}

impl Bsdf {
    /// Lambertian reflection.
    pub fn lambert(albedo: Vec3) -> Self {
        Self::Opaque(Response { diffuse: albedo, coat: None, glossy: None })
    }

    /// Dielectric coat over a Lambertian base. `albedo` is the base's reflectance as seen from outside.
    pub fn plastic(albedo: Vec3, ior: f32, alpha: f32) -> Self {
        Self::coated(albedo, Coat { ior, internal: fresnel::internal_diffuse(ior) }, alpha)
    }

    /// [`Self::plastic`] with a precomputed coat.
    pub fn coated(albedo: Vec3, coat: Coat, alpha: f32) -> Self {
        let glossy = (alpha >= ggx::SMOOTH).then_some(Glossy { alpha, fresnel: Tint::Dielectric(coat.ior) });
        Self::Opaque(Response { diffuse: albedo, coat: Some(coat), glossy })
    }

    /// Conductor with reflectance `f0` at normal incidence.
    pub fn metal(f0: Vec3, alpha: f32) -> Self {
        if alpha < ggx::SMOOTH {
            return Self::Mirror(f0);
        }
        let glossy = Some(Glossy { alpha, fresnel: Tint::Conductor(f0) });
        Self::Opaque(Response { diffuse: Vec3::ZERO, coat: None, glossy })
    }

    /// Pane without thickness.
    pub fn pane(ior: f32, transmittance: Vec3) -> Self {
        Self::Pane { ior, transmittance }
    }

    /// Interface of a solid dielectric. `eta` is the index beyond it, relative to the viewer's side.
    pub fn glass(eta: f32, transmittance: Vec3, alpha: f32) -> Self {
        Self::Glass { eta, transmittance, alpha }
    }

    /// Whether the BSDF has anything besides delta functions.
    #[inline]
    pub fn spreads(&self) -> bool {
        match self {
            Self::Opaque(response) => response.has_diffuse() || response.glossy.is_some(),
            Self::Mirror(_) | Self::Pane { .. } => false,
            Self::Glass { eta, alpha, .. } => is_rough(*eta, *alpha),
        }
    }

    /// Returns `true` if light from the other side of the surface is spread towards the viewer.
    #[inline]
    pub fn spreads_through(&self) -> bool {
        matches!(self, Self::Glass { .. }) && self.spreads()
    }

    /// The reflection from a smooth coat alone. `None` for other materials.
    pub fn mirror(&self, wi: Vec3) -> Option<Scattering> {
        let Self::Opaque(Response { coat: Some(coat), glossy: None, .. }) = self else { return None };
        let reflectance = fresnel::dielectric(wi.z, coat.ior).reflectance;
        Some(mirrored(wi, Vec3::splat(reflectance))).filter(|s| s.weight.x > 0.0)
    }

    /// ρ(wi, wo) |cos θₒ|, without perfect mirrors and smooth transmission.
    pub fn evaluate(&self, wi: Vec3, wo: Vec3) -> Vec3 {
        self.light(wi, wo).0
    }

    /// Density per steradian with which [`Self::sample`] chooses `wo`, without delta functions.
    pub fn density(&self, wi: Vec3, wo: Vec3) -> f32 {
        self.light(wi, wo).1
    }

    /// [`Self::evaluate`] and [`Self::density`] together.
    #[inline]
    pub fn light(&self, wi: Vec3, wo: Vec3) -> (Vec3, f32) {
        match self {
            Self::Opaque(response) => {
                if wo.z <= 0.0 || wi.z <= 0.0 {
                    return (Vec3::ZERO, 0.0);
                }
                let (diffuse, glossy, by_lobe) = response.evaluate(wi, wo);
                let share = glossy_share(response, wi);
                let by_base = if response.has_diffuse() { (1.0 - share) * wo.z * FRAC_1_PI } else { 0.0 };
                let by_lobe = if response.glossy.is_some() { share * by_lobe } else { 0.0 };
                (diffuse + glossy, by_base + by_lobe)
            }
            Self::Glass { eta, transmittance, alpha } if is_rough(*eta, *alpha) => {
                rough_glass(wi, wo, *eta, *transmittance, *alpha)
            }
            _ => (Vec3::ZERO, 0.0),
        }
    }

    /// Samples a direction. `u` and `choice` are uniform random numbers in [0, 1). `None` if the light is
    /// lost: no reflectance, or a microfacet sends it below the surface (single scattering only).
    #[inline]
    pub fn sample(&self, wi: Vec3, u: Vec2, choice: f32) -> Option<Scattering> {
        match self {
            Self::Opaque(response) => self.sample_opaque(response, wi, u, choice),
            Self::Mirror(f0) => Some(mirrored(wi, fresnel::conductor(wi.z, *f0))),
            Self::Pane { ior, transmittance } => {
                let reflectance = fresnel::pane(wi.z, *ior);
                let through = (1.0 - reflectance) * *transmittance;
                let share = reflected_share(reflectance, through);
                Some(if choice < share {
                    mirrored(wi, Vec3::splat(reflectance / share))
                } else {
                    Scattering {
                        direction: -wi,
                        weight: through / (1.0 - share),
                        density: None,
                        lobe: Lobe::Straight,
                    }
                })
            }
            Self::Glass { eta, transmittance, alpha } => {
                self.sample_glass(wi, (*eta, *transmittance, *alpha), u, choice)
            }
        }
        .filter(|scattering| scattering.weight.max_element() > 0.0)
    }

    fn sample_opaque(&self, response: &Response, wi: Vec3, u: Vec2, choice: f32) -> Option<Scattering> {
        let share = glossy_share(response, wi);
        if choice < share {
            let Some(glossy) = response.glossy else {
                let coat = response.coat?;
                let reflectance = fresnel::dielectric(wi.z, coat.ior).reflectance;
                return Some(mirrored(wi, Vec3::splat(reflectance / share)));
            };
            let (wo, weight, density) = glossy.sample(wi, u)?;
            if share == 1.0 {
                return Some(Scattering {
                    direction: wo,
                    weight,
                    density: Some(density),
                    lobe: Lobe::Glossy,
                });
            }
            return self.spread(wi, wo, Lobe::Glossy);
        }
        let wo = geometry::cosine_hemisphere(u);
        if wo.z <= 0.0 {
            return None;
        }
        if response.glossy.is_some() {
            return self.spread(wi, wo, Lobe::Diffuse);
        }
        let weight = response.diffuse(wi, wo) / (1.0 - share);
        let density = Some((1.0 - share) * wo.z * FRAC_1_PI);
        Some(Scattering { direction: wo, weight, density, lobe: Lobe::Diffuse })
    }

    /// The sample for a direction that several lobes could have chosen. Its weight accounts for all of them.
    fn spread(&self, wi: Vec3, wo: Vec3, lobe: Lobe) -> Option<Scattering> {
        let (value, density) = self.light(wi, wo);
        let weight = value / density;
        weight.is_finite().then_some(Scattering { direction: wo, weight, density: Some(density), lobe })
    }

    fn sample_glass(
        &self,
        wi: Vec3,
        (eta, transmittance, alpha): (f32, Vec3, f32),
        u: Vec2,
        choice: f32,
    ) -> Option<Scattering> {
        let rough = is_rough(eta, alpha);
        let h = if rough { ggx::sample_visible(wi, alpha, u) } else { Vec3::Z };
        let interface = fresnel::dielectric(wi.dot(h), eta);
        let through = (1.0 - interface.reflectance) * transmittance;
        let share = reflected_share(interface.reflectance, through);
        let reflects = choice < share;
        let (wo, weight, lobe) = if reflects {
            (ggx::reflect(wi, h), Vec3::splat(interface.reflectance / share), Lobe::Reflection)
        } else {
            let weight = through / ((1.0 - share) * eta * eta);
            (ggx::refract(wi, h, eta, interface.cos_t), weight, Lobe::Refraction)
        };
        if !rough {
            return Some(Scattering { direction: wo, weight, density: None, lobe });
        }
        if (wo.z > 0.0) != reflects || wo.z == 0.0 {
            return None;
        }
        let up = wo.with_z(wo.z.abs());
        let weight = weight * (ggx::masking_shadowing(wi, up, alpha) / ggx::masking(wi, alpha));
        let density = self.density(wi, wo);
        (density > 0.0).then_some(Scattering { direction: wo, weight, density: Some(density), lobe })
    }
}

/// Returns `true` if a glass interface spreads light.
fn is_rough(eta: f32, alpha: f32) -> bool {
    alpha >= ggx::SMOOTH && (eta - 1.0).abs() >= CONTRAST
}

fn mirrored(wi: Vec3, weight: Vec3) -> Scattering {
    let direction = Vec3::new(-wi.x, -wi.y, wi.z);
    Scattering { direction, weight, density: None, lobe: Lobe::Reflection }
}

/// Probability of sampling the reflection rather than the transmission. It is proportional to the light that
/// each carries. At least one of the two is not zero: if nothing is transmitted, the probability is 1.
fn reflected_share(reflectance: f32, through: Vec3) -> f32 {
    let through = through.max_element();
    if through > 0.0 { reflectance / (reflectance + through) } else { 1.0 }
}

/// Probability of sampling the glossy lobe, or the mirror of a smooth coat, rather than the base.
fn glossy_share(response: &Response, wi: Vec3) -> f32 {
    let reflectance = match (response.glossy, response.coat) {
        (Some(glossy), _) => glossy.fresnel.reflectance(wi.z).max_element(),
        (None, Some(coat)) => fresnel::dielectric(wi.z, coat.ior).reflectance,
        (None, None) => return 0.0,
    };
    let base = response.diffuse.max_element();
    if base <= 0.0 {
        return 1.0;
    }
    let share = reflectance / (reflectance + base * (1.0 - reflectance));
    // Microfacets reflect at other angles than the mean surface, so neither lobe may get too few samples.
    if response.glossy.is_some() { share.clamp(0.1, 0.9) } else { share }
}

/// Value times cosine, and density, of a rough interface (Walter et al. 2007, equations 20, 21 and 17).
fn rough_glass(wi: Vec3, wo: Vec3, eta: f32, transmittance: Vec3, alpha: f32) -> (Vec3, f32) {
    let nothing = (Vec3::ZERO, 0.0);
    if wo.z == 0.0 || wi.z <= 0.0 {
        return nothing;
    }
    let reflects = wo.z > 0.0;
    let h = if reflects { wi + wo } else { wi + eta * wo }.normalize_or_zero();
    let h = if h.z < 0.0 { -h } else { h };
    let (cos_i, cos_o) = (wi.dot(h), wo.dot(h));
    // The viewer must see the facet's front, and the light must be on the side that the lobe requires.
    if cos_i <= 0.0 || (cos_o > 0.0) != reflects || cos_o == 0.0 || h.z <= 0.0 {
        return nothing;
    }
    let reflectance = fresnel::dielectric(cos_i, eta).reflectance;
    let through = (1.0 - reflectance) * transmittance;
    let share = reflected_share(reflectance, through);
    let up = wo.with_z(wo.z.abs());
    let (g1, g2) = (ggx::masking(wi, alpha), ggx::masking_shadowing(wi, up, alpha));
    // Density of visible normals, and its Jacobian from normals to directions.
    let normals = ggx::distribution(h, alpha) * cos_i / wi.z;
    let jacobian = if reflects {
        1.0 / (4.0 * cos_i)
    } else {
        let root = cos_i + eta * cos_o;
        eta * eta * -cos_o / (root * root)
    };
    let spread = normals * jacobian;
    let (value, choice) =
        if reflects { (Vec3::splat(reflectance), share) } else { (through / (eta * eta), 1.0 - share) };
    (value * (spread * g2), spread * g1 * choice)
}
