//! The base of a glTF material: its colour, and how metallic and how rough it is.
//!
//! Textures of metalness and roughness are not looked up. Their mean stands for all of the surface, since a
//! material has one kind of surface here. Of `KHR_materials_pbrSpecularGlossiness`, the diffuse colour and
//! the glossiness are read, if the material has no metallic-roughness beside it.

use super::document::resource;
use super::{ROUNDING, Reader};
use crate::error::SceneError;
use gltf::Material;
use gltf::material::{PbrMetallicRoughness, PbrSpecularGlossiness};
use gltf::texture::Info;
use std::borrow::Cow;
use std::collections::BTreeSet;

/// The base of a material. All numbers are in the range 0 to 1.
pub(super) struct Base<'a> {
    /// Linear red, green, blue, and alpha.
    pub(super) factor: [f32; 4],
    pub(super) texture: Option<Info<'a>>,
    pub(super) metallic: f32,
    pub(super) roughness: f32,
}

/// The texture of a material's base colour, if it has an image.
pub(super) fn base_texture<'a>(source: &Material<'a>) -> Option<Info<'a>> {
    given_texture(source).filter(has_image)
}

/// Whether a texture has an image. Those of unknown extensions may have none.
pub(super) fn has_image(info: &Info<'_>) -> bool {
    info.texture().source().is_some()
}

fn given_texture<'a>(source: &Material<'a>) -> Option<Info<'a>> {
    match glossiness(source) {
        Some(glossiness) => glossiness.diffuse_texture(),
        None => source.pbr_metallic_roughness().base_color_texture(),
    }
}

/// The specular-glossiness of a material that has nothing else.
fn glossiness<'a>(source: &Material<'a>) -> Option<PbrSpecularGlossiness<'a>> {
    let pbr = source.pbr_metallic_roughness();
    let is_default = pbr.base_color_texture().is_none()
        && pbr.metallic_roughness_texture().is_none()
        && pbr.base_color_factor() == [1.0; 4]
        && (pbr.metallic_factor(), pbr.roughness_factor()) == (1.0, 1.0);
    source.pbr_specular_glossiness().filter(|_| is_default)
}

/// The number within the range 0 to 1. `None` if it is outside by more than an exporter's rounding.
pub(super) fn unit(value: f32) -> Option<f32> {
    (-ROUNDING..=1.0 + ROUNDING).contains(&value).then(|| value.clamp(0.0, 1.0))
}

impl<'r> Reader<'r, '_> {
    /// The base of a material at the JSON pointer `at`.
    pub(super) fn base<'a>(&mut self, source: &Material<'a>, at: &str) -> Result<Base<'a>, SceneError> {
        let texture = given_texture(source);
        let (factor, metallic, roughness) = match glossiness(source) {
            Some(glossiness) => {
                self.ignore("specular-glossiness (its diffuse colour and glossiness factor are used)");
                (glossiness.diffuse_factor(), 0.0, 1.0 - glossiness.glossiness_factor())
            }
            None => {
                let pbr = source.pbr_metallic_roughness();
                let (metallic, roughness) = self.mean(&pbr);
                let factors = (pbr.metallic_factor() * metallic, pbr.roughness_factor() * roughness);
                (pbr.base_color_factor(), factors.0, factors.1)
            }
        };
        let [r, g, b, alpha] = factor.map(unit);
        match (r, g, b, alpha, unit(metallic), unit(roughness)) {
            (Some(r), Some(g), Some(b), Some(alpha), Some(metallic), Some(roughness)) => {
                Ok(Base { factor: [r, g, b, alpha], texture, metallic, roughness })
            }
            _ => self.opened.fail(
                at,
                "a base colour, roughness, metallic or glossiness factor is not in the range 0 to 1",
            ),
        }
    }

    /// The mean metalness and roughness of a material's texture. 1 if there is none.
    fn mean(&mut self, pbr: &PbrMetallicRoughness<'_>) -> (f32, f32) {
        let Some(info) = pbr.metallic_roughness_texture() else { return (1.0, 1.0) };
        let image = info.texture().source().map(|image| image.index());
        match image.and_then(|image| self.means.get(&image).copied().flatten()) {
            Some(mean) => {
                self.ignore("metallic-roughness textures (their means are used)");
                mean
            }
            None => {
                self.ignore("metallic-roughness textures that cannot be read (left out)");
                (1.0, 1.0)
            }
        }
    }

    /// Finds the means of all images that the file's meshes use for metalness and roughness.
    pub(super) fn find_means(&mut self) {
        let opened = self.opened;
        let materials = opened.document.meshes().flat_map(|mesh| {
            mesh.primitives().filter_map(|primitive| {
                let pbr = primitive.material().pbr_metallic_roughness();
                Some(pbr.metallic_roughness_texture()?.texture().source()?.index())
            })
        });
        let images: Vec<usize> = materials.collect::<BTreeSet<_>>().into_iter().collect();
        let contents: Vec<Option<Cow<'r, [u8]>>> =
            images.iter().map(|&image| self.image_bytes(image).ok()).collect();
        let means = self.assembly.textures.means(&contents);
        // Metalness is blue, roughness is green (glTF 2.0 specification, section 3.9.2).
        self.means =
            images.into_iter().zip(means.into_iter().map(|mean| mean.map(|[_, g, b]| (b, g)))).collect();
    }

    /// The encoded bytes of an image.
    fn image_bytes(&self, image: usize) -> Result<Cow<'r, [u8]>, SceneError> {
        let (opened, pointer) = (self.opened, format!("/images/{image}"));
        let source = &opened.document.as_json().images[image];
        match (&source.uri, &source.buffer_view) {
            (Some(uri), _) => resource(self.assembly.bundle, &opened.file, uri, &pointer).map(Cow::Owned),
            (None, Some(view)) => opened.view(view.value()).map(Cow::Borrowed),
            (None, None) => opened.fail(&pointer, "has neither a `uri` nor a `bufferView`"),
        }
    }
}
