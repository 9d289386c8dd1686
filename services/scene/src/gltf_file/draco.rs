//! Meshes of `KHR_draco_mesh_compression`.

use draco_core::{DecodeLimits, DecoderBuffer, Mesh, MeshDecoder};
use serde::Deserialize;
use std::collections::BTreeMap;

/// The extension object of a primitive.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compressed {
    /// Index of the buffer view with the stream.
    pub(super) buffer_view: usize,
    /// The stream's own numbers of the attributes, by the name in glTF.
    pub(super) attributes: BTreeMap<String, u32>,
}

/// Bytes of a vertex with every attribute that glTF has, generously.
const LARGEST_VERTEX: u64 = 256;

/// A decoded primitive.
pub(super) struct Decoded<'a> {
    mesh: Mesh,
    attributes: &'a BTreeMap<String, u32>,
}

impl<'a> Decoded<'a> {
    /// Decodes a stream to at most `faces` triangles. Fails with a reason if it is malformed or larger.
    pub(super) fn new(
        stream: &[u8],
        attributes: &'a BTreeMap<String, u32>,
        faces: u64,
    ) -> Result<Self, String> {
        // Every vertex is a corner of some triangle.
        let bytes = faces.saturating_mul(3 * LARGEST_VERTEX).min(DecodeLimits::default().max_decoded_bytes);
        let limits = DecodeLimits::default().with_max_faces(faces).with_max_decoded_bytes(bytes);
        let mut mesh = Mesh::new();
        MeshDecoder::new()
            .decode(&mut DecoderBuffer::new(stream).with_limits(limits), &mut mesh)
            .map_err(|error| format!("the Draco stream cannot be decoded: {error}"))?;
        Ok(Self { mesh, attributes })
    }

    /// Indices of the corners of all triangles.
    pub(super) fn indices(&self) -> Vec<u32> {
        self.mesh.faces().iter().flatten().map(|point| point.0).collect()
    }

    /// The values of an attribute with `N` components, for each vertex. `None` if the attribute is not in the
    /// stream but in an accessor. Fails with a reason if the stream does not have it.
    pub(super) fn floats<const N: usize>(&self, name: &str) -> Option<Result<Vec<[f32; N]>, String>> {
        let number = *self.attributes.get(name)?;
        let Some(attribute) = self.mesh.attribute_by_unique_id(number) else {
            return Some(Err(format!("the Draco stream has no attribute {number}")));
        };
        let found = attribute.num_components();
        if usize::from(found) != N {
            let reason = format!("has {found} components in the Draco stream where {N} are needed");
            return Some(Err(reason));
        }
        let values = attribute.read_f32s(self.mesh.num_points(), N);
        Some(Ok(values.as_chunks::<N>().0.to_vec()))
    }
}
