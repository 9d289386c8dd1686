//! Materials: how a surface scatters, transmits and emits.

use crate::TextureId;
use glam::Vec3;
use std::num::NonZeroU8;

/// A colour that a texture may vary over the surface: `factor` × texture (texture absent: `factor`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Color {
    /// Linear Rec. 709 multiplier.
    pub factor: Vec3,
    /// Image, looked up at the hit's texture coordinates.
    pub texture: Option<TextureId>,
}

impl Color {
    /// A colour without a texture.
    pub const fn plain(factor: Vec3) -> Self {
        Self { factor, texture: None }
    }
}

/// How light leaves a surface on which it arrives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// Lambert reflection, two-sided.
    Lambert {
        /// Diffuse reflectance.
        albedo: Color,
    },
    /// Smooth or rough dielectric coat over a Lambert base.
    Plastic {
        /// Diffuse reflectance of the base.
        albedo: Color,
        /// Index of refraction of the coat.
        ior: f32,
        /// GGX alpha of the coat (roughness squared); 0 is a mirror-like coat.
        alpha: f32,
    },
    /// Opaque conductor.
    Metal {
        /// Fresnel reflectance at normal incidence.
        f0: Color,
        /// GGX alpha; 0 is a perfect mirror.
        alpha: f32,
    },
    /// A pane without thickness: Fresnel reflection (both faces) and straight transmission.
    ThinGlass {
        /// Index of refraction.
        ior: f32,
        /// Share of light that passes, per channel.
        transmittance: Color,
    },
    /// Boundary of a solid dielectric; the outside is where the geometric normal points.
    Glass {
        /// Index of refraction of the inside: relative to the outside, whatever that is; with a priority, relative to empty space.
        ior: f32,
        /// Share of light that passes the interface, per channel.
        transmittance: Color,
        /// GGX alpha; 0 is smooth.
        alpha: f32,
        /// Where solids with a priority overlap or touch, the one of highest priority fills the place, and the faces of the others inside
        /// it are not there.
        priority: Option<NonZeroU8>,
    },
}

impl Surface {
    /// The priority among solid dielectrics, if it is one and has one.
    pub fn priority(&self) -> Option<NonZeroU8> {
        match self {
            Self::Glass { priority, .. } => *priority,
            _ => None,
        }
    }
}

/// How many materials of a scene may have a priority.
pub const MOST_NESTED: usize = 32;

/// Cut-out by a texture's alpha channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlphaMask {
    /// The texture whose alpha counts.
    pub texture: TextureId,
    /// The surface is there where alpha ≥ cutoff.
    pub cutoff: f32,
}

/// The paper's material classes, by which an ID preview is coloured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MaterialClass {
    /// Lets light through: shown in red.
    Transparent,
    /// Mirror-like or glossy: shown in blue.
    Specular,
    /// Everything else: shown in green.
    Diffuse,
}

/// One material of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Name in the bundle.
    pub name: String,
    /// Reflection and transmission.
    pub surface: Surface,
    /// Radiance emitted from the front side (where the winding's normal points); zero emits nothing.
    pub emission: Color,
    /// Whether the back side emits too (glTF `doubleSided`).
    pub emits_both_sides: bool,
    /// Constant opacity in [0, 1]: the share of light that the surface stops; below 1 it is a cut-out.
    pub opacity: f32,
    /// Texture cut-out.
    pub mask: Option<AlphaMask>,
}

impl Material {
    /// Whether the surface emits light at all.
    pub fn is_emissive(&self) -> bool {
        self.emission.factor.max_element() > 0.0
    }

    /// Whether a ray may pass the surface as if it were not there.
    pub fn is_cutout(&self) -> bool {
        self.opacity < 1.0 || self.mask.is_some()
    }

    /// The paper's class (section 2, step 1).
    pub fn class(&self) -> MaterialClass {
        match self.surface {
            Surface::ThinGlass { .. } | Surface::Glass { .. } => MaterialClass::Transparent,
            Surface::Metal { .. } | Surface::Plastic { .. } => MaterialClass::Specular,
            Surface::Lambert { .. } if self.is_cutout() => MaterialClass::Transparent,
            Surface::Lambert { .. } => MaterialClass::Diffuse,
        }
    }
}
