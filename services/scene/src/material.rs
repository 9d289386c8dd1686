//! Materials: how a surface reflects, transmits and emits light.

use crate::TextureId;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::num::NonZeroU8;

/// A colour, optionally varied by a texture: `factor` × texture, or `factor` alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Color {
    /// Linear Rec. 709 multiplier.
    pub factor: Vec3,
    /// Image, sampled at the hit's texture coordinates.
    pub texture: Option<TextureId>,
}

impl Color {
    /// A colour without a texture.
    pub const fn plain(factor: Vec3) -> Self {
        Self { factor, texture: None }
    }
}

/// How a surface scatters light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Surface {
    /// Lambertian reflection, on both sides.
    Lambert {
        /// Diffuse reflectance.
        albedo: Color,
    },
    /// Smooth or rough dielectric coat over a Lambertian base.
    Plastic {
        /// Diffuse reflectance of the base.
        albedo: Color,
        /// Index of refraction of the coat.
        ior: f32,
        /// GGX alpha of the coat (roughness squared). 0 is a smooth coat.
        alpha: f32,
    },
    /// Opaque conductor.
    Metal {
        /// Fresnel reflectance at normal incidence.
        f0: Color,
        /// GGX alpha. 0 is a perfect mirror.
        alpha: f32,
    },
    /// A pane without thickness: Fresnel reflection from both faces, and straight transmission.
    ThinGlass {
        /// Index of refraction.
        ior: f32,
        /// Fraction of light transmitted, per channel.
        transmittance: Color,
    },
    /// Boundary of a solid dielectric. The geometric normal points to the outside.
    Glass {
        /// Index of refraction of the inside: relative to vacuum with a priority, else to the outside.
        ior: f32,
        /// Fraction of light transmitted at the interface, per channel.
        transmittance: Color,
        /// GGX alpha. 0 is smooth.
        alpha: f32,
        /// Rank among overlapping or touching solids. The highest fills the space; others' faces in it are
        /// ignored.
        priority: Option<NonZeroU8>,
    },
}

impl Surface {
    /// The priority of a solid dielectric that has one.
    pub fn priority(&self) -> Option<NonZeroU8> {
        match self {
            Self::Glass { priority, .. } => *priority,
            _ => None,
        }
    }
}

/// Largest number of materials with a priority in a scene.
pub const MOST_NESTED: usize = 32;

/// Cut-out by a texture's alpha channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AlphaMask {
    /// The texture whose alpha channel is used.
    pub texture: TextureId,
    /// The surface exists where alpha ≥ cutoff.
    pub cutoff: f32,
}

/// The material classes of Gillibrand et al. 2006. They determine the colour in an ID preview.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MaterialClass {
    /// Transmits light. Shown in red.
    Transparent,
    /// Mirror-like or glossy. Shown in blue.
    Specular,
    /// Everything else. Shown in green.
    Diffuse,
}

/// One material of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Name in the bundle.
    pub name: String,
    /// Reflection and transmission.
    pub surface: Surface,
    /// Radiance emitted from the front side, to which the geometric normal points. Zero emits nothing.
    pub emission: Color,
    /// Whether the back side emits too (glTF `doubleSided`).
    pub emits_both_sides: bool,
    /// Constant opacity in [0, 1]: the fraction of light that the surface stops. Below 1 it is a cut-out.
    pub opacity: f32,
    /// Texture cut-out.
    pub mask: Option<AlphaMask>,
}

impl Material {
    /// Returns `true` if the surface emits light.
    pub fn is_emissive(&self) -> bool {
        self.emission.factor.max_element() > 0.0
    }

    /// Returns `true` if a ray may pass the surface unchanged.
    pub fn is_cutout(&self) -> bool {
        self.opacity < 1.0 || self.mask.is_some()
    }

    /// The material class (Gillibrand et al. 2006, section 2, step 1).
    pub fn class(&self) -> MaterialClass {
        match self.surface {
            Surface::ThinGlass { .. } | Surface::Glass { .. } => MaterialClass::Transparent,
            Surface::Metal { .. } | Surface::Plastic { .. } => MaterialClass::Specular,
            Surface::Lambert { .. } if self.is_cutout() => MaterialClass::Transparent,
            Surface::Lambert { .. } => MaterialClass::Diffuse,
        }
    }
}
