//! The effects that a frame needs, from its materials, lights, camera and settings. The kernel is composed
//! from them (see `kernel`). Other effects take no rays and no memory.

use crate::Settings;
use crate::environment::Sky;
use crate::lights::Looks;
use crate::microfacet::SMOOTH;
use forelight_protocol::Integrator;
use forelight_scene::{Camera, Color, Material, Sun, Surface};
use std::fmt;
use std::ops::BitOr;

/// A set of effects.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Effects(u32);

/// Bit and name of each effect.
const NAMES: [(u32, &str); 19] = [
    (Effects::GLOSSY, "glossy"),
    (Effects::MIRROR, "mirror"),
    (Effects::REFRACTION, "refraction"),
    (Effects::NESTED_MEDIA, "nested media"),
    (Effects::THIN_GLASS, "thin glass"),
    (Effects::OPACITY, "opacity"),
    (Effects::CUT_OUTS, "cut-outs"),
    (Effects::TEXTURES, "textures"),
    (Effects::TRANSPARENT_SHADOWS, "transparent shadows"),
    (Effects::SOFT_SHADOWS, "soft shadows"),
    (Effects::AREA_LIGHTS, "area lights"),
    (Effects::POINT_LIGHTS, "point lights"),
    (Effects::LIGHT_CHOICE, "choice of lights"),
    (Effects::SUN, "sun"),
    (Effects::ENVIRONMENT, "environment"),
    (Effects::AMBIENT, "ambient"),
    (Effects::SECOND_BOUNCE, "second ambient bounce"),
    (Effects::CACHE, "irradiance cache"),
    (Effects::DEPTH_OF_FIELD, "depth of field"),
];

impl Effects {
    /// Rough reflection, followed by rays of its own.
    pub const GLOSSY: u32 = 1;
    /// Perfect reflection: smooth metals and smooth coats.
    pub const MIRROR: u32 = 1 << 1;
    /// Solid glass.
    pub const REFRACTION: u32 = 1 << 2;
    /// Panes without thickness.
    pub const THIN_GLASS: u32 = 1 << 3;
    /// Surfaces that stop part of the light.
    pub const OPACITY: u32 = 1 << 4;
    /// Surfaces with a cut-out texture.
    pub const CUT_OUTS: u32 = 1 << 5;
    /// Colours that vary by texture.
    pub const TEXTURES: u32 = 1 << 6;
    /// Shadow rays that a surface may tint instead of blocking.
    pub const TRANSPARENT_SHADOWS: u32 = 1 << 7;
    /// Lights of finite size.
    pub const SOFT_SHADOWS: u32 = 1 << 8;
    /// Emissive surfaces.
    pub const AREA_LIGHTS: u32 = 1 << 9;
    /// Point and spot lights.
    pub const POINT_LIGHTS: u32 = 1 << 10;
    /// Distant lights.
    pub const SUN: u32 = 1 << 11;
    /// Light from the surroundings.
    pub const ENVIRONMENT: u32 = 1 << 12;
    /// Indirect diffuse light.
    pub const AMBIENT: u32 = 1 << 13;
    /// More than one bounce of indirect diffuse light.
    pub const SECOND_BOUNCE: u32 = 1 << 14;
    /// Indirect diffuse light by interpolation in an irradiance cache.
    pub const CACHE: u32 = 1 << 15;
    /// A lens with a finite aperture.
    pub const DEPTH_OF_FIELD: u32 = 1 << 16;
    /// Points sample only some of the lights with a position, chosen by a light tree.
    pub const LIGHT_CHOICE: u32 = 1 << 17;
    /// Solid glass with priorities. Rays keep track of the solids that they are inside of.
    pub const NESTED_MEDIA: u32 = 1 << 18;

    /// This set plus all effects that a scene can contain, without those of the method.
    pub fn with_all(self) -> Self {
        let how = Self::AMBIENT | Self::SECOND_BOUNCE | Self::CACHE | Self::LIGHT_CHOICE;
        let all = NAMES.iter().fold(0, |set, (bit, _)| set | bit);
        Self(all & !how | self.0)
    }

    /// Returns `true` if all of `bits` are in the set.
    pub fn has(self, bits: u32) -> bool {
        self.0 & bits == bits
    }

    /// The set as bits.
    pub fn bits(self) -> u32 {
        self.0
    }

    /// Names of the effects in the set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        NAMES.iter().filter(move |(bit, _)| self.has(*bit)).map(|(_, name)| *name)
    }
}

/// Everything that determines the effects of a frame.
pub(crate) struct CalledFor<'a> {
    /// Materials of the surfaces that can be met, after the settings' material override.
    pub materials: &'a [&'a Material],
    /// Number of area lights, and of point lights, that are sampled.
    pub area_lights: usize,
    pub points: usize,
    /// Suns that are sampled.
    pub suns: &'a [Sun],
    /// Number of lights with a position that each point samples.
    pub looks: Looks,
    pub sky: &'a Sky,
    pub camera: &'a Camera,
    pub settings: &'a Settings,
}

impl CalledFor<'_> {
    /// The effects of the frame.
    pub fn effects(&self) -> Effects {
        let mut set = Effects::default();
        let mut add = |bit: u32, called_for: bool| set.0 |= if called_for { bit } else { 0 };
        for material in self.materials {
            let rough = |alpha: f32| alpha >= SMOOTH;
            match material.surface {
                Surface::Lambert { .. } => {}
                Surface::Metal { alpha, .. } | Surface::Plastic { alpha, .. } => {
                    add(Effects::GLOSSY, rough(alpha));
                    add(Effects::MIRROR, !rough(alpha));
                }
                Surface::ThinGlass { .. } => add(Effects::THIN_GLASS | Effects::TRANSPARENT_SHADOWS, true),
                Surface::Glass { priority, .. } => {
                    add(Effects::REFRACTION, true);
                    add(Effects::NESTED_MEDIA, priority.is_some());
                }
            }
            add(Effects::OPACITY | Effects::TRANSPARENT_SHADOWS, material.opacity < 1.0);
            add(Effects::CUT_OUTS, material.mask.is_some());
            add(Effects::TEXTURES, colors(material).any(|color| color.texture.is_some()));
        }
        let Settings { ambient_bounces, integrator, cache, .. } = *self.settings;
        add(Effects::AREA_LIGHTS | Effects::SOFT_SHADOWS, self.area_lights > 0);
        add(Effects::POINT_LIGHTS, self.points > 0);
        add(Effects::SUN, !self.suns.is_empty());
        add(Effects::SOFT_SHADOWS, self.suns.iter().any(|sun| sun.angle_deg > 0.0));
        add(Effects::ENVIRONMENT, !self.sky.is_black());
        // Without light there is nothing to gather.
        let lit = Effects::AREA_LIGHTS | Effects::POINT_LIGHTS | Effects::SUN | Effects::ENVIRONMENT;
        let gathers = ambient_bounces > 0 && set.0 & lit != 0;
        let mut add = |bit: u32, called_for: bool| set.0 |= if called_for { bit } else { 0 };
        add(Effects::AMBIENT, gathers);
        let gathered = gathers && self.looks.gathered.is_some();
        add(
            Effects::LIGHT_CHOICE,
            integrator == Integrator::Ambient && (self.looks.seen.is_some() || gathered),
        );
        add(Effects::SECOND_BOUNCE, gathers && ambient_bounces > 1);
        let cached = cache.is_some() && integrator == Integrator::Ambient;
        add(Effects::CACHE, gathers && cached);
        add(Effects::DEPTH_OF_FIELD, self.camera.aperture_radius > 0.0);
        set
    }
}

impl BitOr<u32> for Effects {
    type Output = Self;
    fn bitor(self, bits: u32) -> Self {
        Self(self.0 | bits)
    }
}

impl fmt::Debug for Effects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.names()).finish()
    }
}

/// The colours of a material.
fn colors(material: &Material) -> impl Iterator<Item = &Color> {
    let surface = match &material.surface {
        Surface::Lambert { albedo } | Surface::Plastic { albedo, .. } => albedo,
        Surface::Metal { f0, .. } => f0,
        Surface::ThinGlass { transmittance, .. } | Surface::Glass { transmittance, .. } => transmittance,
    };
    [surface, &material.emission].into_iter()
}
