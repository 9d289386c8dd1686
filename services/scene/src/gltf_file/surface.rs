//! Converts glTF materials to the materials of this crate.
//!
//! | glTF | here |
//! | --- | --- |
//! | transmission ≥ ½, with a volume thickness | glass; transmittance is base colour × transmission |
//! | transmission ≥ ½, without a volume thickness | thin glass with the same transmittance |
//! | metallic ≥ ½ (see [`base`](super::base)) | metal; base colour is the reflectance at normal incidence |
//! | specular factor or colour 0, or index of refraction 1 | Lambert |
//! | otherwise | plastic with the given index of refraction |
//!
//! GGX alpha is roughness². `MASK` is a cut-out by the texture's alpha. `BLEND` becomes constant opacity from
//! the base colour's alpha, and a cut-out at one half from the texture's. The extra `priority` ranks
//! overlapping solids. Other textures than base colour and emission are ignored with a warning, apart from
//! the means of metalness and roughness.

use super::Reader;
use super::base::{Base, base_texture, unit};
use super::document::{resource, resource_path};
use crate::assembly::plain_material;
use crate::error::{Place, SceneError};
use crate::{AlphaMask, Color, Material, Surface, TextureId};
use glam::Vec3;
use gltf::material::AlphaMode;
use gltf::texture::WrappingMode;
use std::num::NonZeroU8;

/// Index of refraction of a material that does not specify it.
const DEFAULT_IOR: f32 = 1.5;

impl Reader<'_, '_> {
    /// The material's index in the assembly. A material is read when it is first used.
    pub(super) fn material(&mut self, source: &gltf::Material<'_>) -> Result<u32, SceneError> {
        if let Some(&known) = self.materials.get(&source.index()) {
            return Ok(known);
        }
        let material = match source.index() {
            Some(index) => self.read_material(source, index)?,
            None => {
                self.ignore("faces without a material (rendered grey)");
                let albedo = Color::plain(Vec3::splat(0.5));
                plain_material("(no material)", Surface::Lambert { albedo })
            }
        };
        let index = self.assembly.add_material(material);
        self.assembly.check_priorities(&self.opened.file)?;
        self.materials.insert(source.index(), index);
        Ok(index)
    }

    fn read_material(&mut self, source: &gltf::Material<'_>, index: usize) -> Result<Material, SceneError> {
        let at = format!("/materials/{index}");
        let base = self.base(source, &at)?;
        let [r, g, b, alpha] = base.factor;
        let texture = match &base.texture {
            Some(info) => self.texture(&info.texture())?,
            None => None,
        };
        if let Some(texture) = texture {
            let checked = self.assembly.textures.check_reflectance(texture);
            let place = Place::Pointer(format!("{at}/pbrMetallicRoughness/baseColorTexture"));
            checked.map_err(|e| e.within(&self.opened.file, place, "the base colour"))?;
        }
        let colour = Color { factor: Vec3::new(r, g, b), texture };
        let surface = self.surface(source, &at, &base, colour)?;
        let name = source.name().map_or_else(|| format!("material {index}"), str::to_owned);
        let mut material = plain_material(&name, surface);
        material.emission = self.emission(source, &at)?;
        material.emits_both_sides = source.double_sided();
        match source.alpha_mode() {
            AlphaMode::Opaque => {}
            AlphaMode::Mask => mask(&mut material, alpha, source.alpha_cutoff().unwrap_or(0.5), texture),
            AlphaMode::Blend => {
                material.opacity = alpha;
                if let Some(texture) = texture.filter(|&t| self.assembly.textures.has_alpha(t)) {
                    self.ignore("blending by a texture's alpha (rendered as a cut-out at one half)");
                    material.mask = Some(AlphaMask { texture, cutoff: 0.5 });
                }
            }
        }
        self.note_ignored_textures(source);
        Ok(material)
    }

    fn surface(
        &mut self,
        source: &gltf::Material<'_>,
        at: &str,
        base: &Base<'_>,
        colour: Color,
    ) -> Result<Surface, SceneError> {
        let alpha = base.roughness * base.roughness;
        let ior = match source.ior() {
            None => DEFAULT_IOR,
            // In `KHR_materials_ior`, 0 means full reflection, for compatibility with older materials.
            Some(0.0) => DEFAULT_IOR,
            Some(ior) if (1.0..=10.0).contains(&ior) => ior,
            Some(ior) => {
                return self
                    .opened
                    .fail(at, format!("an index of refraction of {ior} is not in the range 1 to 10"));
            }
        };
        let transmission = source.transmission().map_or(0.0, |t| t.transmission_factor());
        let Some(transmission) = unit(transmission) else {
            return self.opened.fail(at, "the transmission factor is not in the range 0 to 1");
        };
        let no_coat = source.specular().is_some_and(|specular| {
            specular.specular_factor() == 0.0 || specular.specular_color_factor() == [0.0; 3]
        });
        let transmittance = Color { factor: colour.factor * transmission, texture: colour.texture };
        Ok(if transmission >= 0.5 {
            match source.volume() {
                Some(volume) if volume.thickness_factor() > 0.0 => {
                    if volume.attenuation_distance().is_finite() {
                        self.ignore("the attenuation of volumes");
                    }
                    Surface::Glass { ior, transmittance, alpha, priority: self.priority(source, at)? }
                }
                _ => Surface::ThinGlass { ior, transmittance },
            }
        } else if base.metallic >= 0.5 {
            Surface::Metal { f0: colour, alpha }
        } else if no_coat || ior == 1.0 {
            Surface::Lambert { albedo: colour }
        } else {
            Surface::Plastic { albedo: colour, ior, alpha }
        })
    }

    /// The extra `priority`, a custom property in Blender: which of two overlapping solids fills the space.
    fn priority(&self, source: &gltf::Material<'_>, at: &str) -> Result<Option<NonZeroU8>, SceneError> {
        let extras = source.extras().as_ref().and_then(|raw| {
            serde_json::from_str::<serde_json::Map<String, serde_json::Value>>(raw.get()).ok()
        });
        let Some(priority) = extras.as_ref().and_then(|extras| extras.get("priority")) else {
            return Ok(None);
        };
        let number = priority.as_u64().and_then(|n| u8::try_from(n).ok()).and_then(NonZeroU8::new);
        match number {
            Some(number) => Ok(Some(number)),
            None => {
                let at = format!("{at}/extras/priority");
                self.opened.fail(&at, format!("{priority} is not a whole number from 1 to 255"))
            }
        }
    }

    /// Emitted radiance: emissive factor × strength.
    fn emission(&mut self, source: &gltf::Material<'_>, at: &str) -> Result<Color, SceneError> {
        let strength = source.emissive_strength().unwrap_or(1.0);
        let factor = Vec3::from_array(source.emissive_factor()) * strength;
        if !factor.is_finite() || factor.min_element() < 0.0 || factor.max_element() > 1e12 {
            return self.opened.fail(at, "the emission is not in the range 0 to 1e12");
        }
        let texture = match source.emissive_texture() {
            Some(info) if factor != Vec3::ZERO => {
                let base = base_texture(source);
                if base.is_some_and(|base| placed(&base) != placed(&info)) {
                    self.ignore("an emission texture's own coordinates");
                }
                self.texture(&info.texture())?
            }
            _ => None,
        };
        Ok(Color { factor, texture })
    }

    fn note_ignored_textures(&mut self, source: &gltf::Material<'_>) {
        let specular = source.specular();
        for (what, given) in [
            ("normal textures", source.normal_texture().is_some()),
            (
                "transmission textures",
                source.transmission().is_some_and(|t| t.transmission_texture().is_some()),
            ),
            ("thickness textures", source.volume().is_some_and(|v| v.thickness_texture().is_some())),
            (
                "specular textures",
                specular
                    .is_some_and(|s| s.specular_texture().is_some() || s.specular_color_texture().is_some()),
            ),
        ] {
            if given {
                self.ignore(what);
            }
        }
    }

    /// The image of a texture. `None` if it has none, or only one of an extension that is not read.
    fn texture(&mut self, texture: &gltf::Texture<'_>) -> Result<Option<TextureId>, SceneError> {
        let Some(image) = texture.source() else {
            self.ignore("textures without an image (left out)");
            return Ok(None);
        };
        let sampler = texture.sampler();
        if sampler.wrap_s() != WrappingMode::Repeat || sampler.wrap_t() != WrappingMode::Repeat {
            self.ignore("texture wrapping other than repeat");
        }
        let index = image.index();
        let pointer = format!("/images/{index}");
        let opened = self.opened;
        let embedded = format!("{}#image{index}", opened.file);
        if let Some(known) = self.assembly.textures.known(&embedded) {
            return Ok(Some(known));
        }
        let source = &opened.document.as_json().images[index];
        let context = "the image";
        let loaded = match (&source.uri, &source.buffer_view) {
            (Some(uri), _) if !uri.starts_with("data:") => {
                let path = resource_path(&opened.file, uri)
                    .map_err(|reason| SceneError::pointer(&opened.file, &pointer, reason))?;
                self.assembly.textures.load(&path)
            }
            (Some(uri), _) => {
                let bytes = resource(self.assembly.bundle, &opened.file, uri, &pointer)?;
                self.assembly.textures.decode(&embedded, &bytes)
            }
            (None, Some(view)) => self.assembly.textures.decode(&embedded, opened.view(view.value())?),
            (None, None) => return opened.fail(&pointer, "has neither a `uri` nor a `bufferView`"),
        };
        loaded.map(Some).map_err(|e| e.within(&opened.file, Place::Pointer(pointer), context))
    }
}

/// The texture coordinate set of a texture, and its offset, rotation and scale.
fn placed(info: &gltf::texture::Info<'_>) -> (u32, [f32; 2], f32, [f32; 2]) {
    match info.texture_transform() {
        None => (info.tex_coord(), [0.0; 2], 0.0, [1.0; 2]),
        Some(moved) => {
            let set = moved.tex_coord().unwrap_or(info.tex_coord());
            (set, moved.offset(), moved.rotation(), moved.scale())
        }
    }
}

/// Applies `MASK`: the surface exists where factor × texture alpha reaches the cutoff.
fn mask(material: &mut Material, factor: f32, cutoff: f32, texture: Option<TextureId>) {
    match texture {
        Some(texture) if factor > 0.0 => material.mask = Some(AlphaMask { texture, cutoff: cutoff / factor }),
        _ => material.opacity = if factor >= cutoff { 1.0 } else { 0.0 },
    }
}
