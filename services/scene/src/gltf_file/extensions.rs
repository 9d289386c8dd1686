//! The extensions that the `gltf` crate drops: compressed buffer views and meshes, WebP textures.

use super::draco::Compressed as DracoMesh;
use super::meshopt::Compressed as CompressedView;
use crate::description::json_pointer;
use gltf::Semantic;
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// The extensions that this module reads.
pub(super) const COMPRESSION: [&str; 4] =
    ["EXT_meshopt_compression", "EXT_texture_webp", "KHR_draco_mesh_compression", "KHR_meshopt_compression"];

/// Extension objects by the index of what they extend.
#[derive(Debug, Default)]
pub(super) struct Extensions {
    /// Compressed buffer views.
    pub(super) views: BTreeMap<usize, CompressedView>,
    /// Buffers without contents, that only compressed buffer views refer to.
    pub(super) placeholders: BTreeSet<usize>,
    /// Compressed primitives, by mesh and primitive.
    pub(super) meshes: BTreeMap<(usize, usize), DracoMesh>,
    /// Images of textures, where a WebP image is given.
    pub(super) webp: BTreeMap<usize, usize>,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
struct RawDocument {
    buffers: Vec<Extended<RawBuffer>>,
    buffer_views: Vec<Extended<RawView>>,
    textures: Vec<Extended<RawTexture>>,
    meshes: Vec<RawMesh>,
}

#[derive(Deserialize)]
struct Extended<E> {
    extensions: Option<E>,
}

#[derive(Deserialize)]
struct RawBuffer {
    #[serde(rename = "EXT_meshopt_compression")]
    ext: Option<Placeholder>,
    #[serde(rename = "KHR_meshopt_compression")]
    khr: Option<Placeholder>,
}

#[derive(Deserialize)]
struct Placeholder {
    #[serde(default)]
    fallback: bool,
}

#[derive(Deserialize)]
struct RawView {
    #[serde(rename = "EXT_meshopt_compression")]
    ext: Option<CompressedView>,
    #[serde(rename = "KHR_meshopt_compression")]
    khr: Option<CompressedView>,
}

#[derive(Deserialize)]
struct RawTexture {
    #[serde(rename = "EXT_texture_webp")]
    webp: Option<RawSource>,
}

#[derive(Deserialize)]
struct RawSource {
    source: usize,
}

#[derive(Deserialize)]
struct RawMesh {
    #[serde(default)]
    primitives: Vec<Extended<RawPrimitive>>,
}

#[derive(Deserialize)]
struct RawPrimitive {
    #[serde(rename = "KHR_draco_mesh_compression")]
    draco: Option<DracoMesh>,
}

fn indexed<E>(list: Vec<Extended<E>>) -> impl Iterator<Item = (usize, E)> {
    list.into_iter().enumerate().filter_map(|(i, extended)| Some((i, extended.extensions?)))
}

impl Extensions {
    /// Reads the document a second time if it uses one of these extensions. Fails with a JSON pointer and a
    /// reason if an extension object is malformed.
    pub(super) fn read(root: &Root, json: &[u8]) -> Result<Self, (String, String)> {
        let named = root.extensions_used.iter().chain(&root.extensions_required);
        if !named.into_iter().any(|name| COMPRESSION.contains(&name.as_str())) {
            return Ok(Self::default());
        }
        let mut deserializer = serde_json::Deserializer::from_slice(json);
        let raw: RawDocument = serde_path_to_error::deserialize(&mut deserializer)
            .map_err(|e| (json_pointer(e.path()), e.inner().to_string()))?;
        let mut extensions = Self::default();
        for (i, buffer) in indexed(raw.buffers) {
            if buffer.ext.or(buffer.khr).is_some_and(|buffer| buffer.fallback) {
                extensions.placeholders.insert(i);
            }
        }
        extensions.views.extend(indexed(raw.buffer_views).filter_map(|(i, v)| Some((i, v.ext.or(v.khr)?))));
        extensions.webp.extend(indexed(raw.textures).filter_map(|(i, t)| Some((i, t.webp?.source))));
        for (m, mesh) in raw.meshes.into_iter().enumerate() {
            let primitives = indexed(mesh.primitives);
            extensions.meshes.extend(primitives.filter_map(|(p, raw)| Some(((m, p), raw.draco?))));
        }
        Ok(extensions)
    }

    /// Lets textures refer to their WebP images, so that they are checked and read as any image.
    pub(super) fn use_webp(&self, root: &mut Root) {
        for (&texture, &image) in &self.webp {
            if let (Some(texture), Ok(image)) = (root.textures.get_mut(texture), u32::try_from(image)) {
                texture.source = Index::new(image);
            }
        }
    }

    /// The accessors of compressed meshes. They need no buffer view: their elements are in the stream, or are
    /// zeros. Positions must be in the stream.
    pub(super) fn accessors_without_view(&self, root: &Root) -> BTreeSet<usize> {
        let mut accessors = BTreeSet::new();
        for (&(mesh, primitive), compressed) in &self.meshes {
            let Some(primitive) = root.meshes.get(mesh).and_then(|mesh| mesh.primitives.get(primitive))
            else {
                continue;
            };
            accessors.extend(primitive.indices.map(|index| index.value()));
            let positions = Checked::Valid(Semantic::Positions);
            let has_positions = compressed.attributes.contains_key("POSITION");
            let attributes = primitive.attributes.iter();
            accessors.extend(
                attributes.filter(|(name, _)| has_positions || **name != positions).map(|(_, i)| i.value()),
            );
        }
        accessors
    }
}
