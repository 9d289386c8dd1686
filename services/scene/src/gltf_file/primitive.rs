//! Reads the triangles of a glTF primitive.

use super::Reader;
use super::accessors::fraction;
use super::base::{base_texture, has_image};
use super::document::Opened;
use super::draco::Decoded;
use crate::error::SceneError;
use crate::shot::{Mesh, unit_or_zero};
use glam::{Vec2, Vec3};
use gltf::Semantic;
use gltf::mesh::Mode;
use gltf::texture::TextureTransform;

impl Reader<'_, '_> {
    /// The local mesh of a primitive. `key` is its mesh's index and its own. `None` for points and lines.
    pub(super) fn mesh(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        key: (usize, usize),
        at: &str,
    ) -> Result<Option<Mesh>, SceneError> {
        if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            self.ignore("points and lines");
            return Ok(None);
        }
        if primitive.morph_targets().next().is_some() {
            self.ignore("morph targets");
        }
        // Accessors may be longer than the file that names them: no longer than those of the largest mesh.
        let largest = self.assembly.bundle.limits().triangles.saturating_mul(3);
        let most = self.spend(0)?.min(largest);
        let source = self.source(primitive, key, at, most)?;
        let Some(positions) = source.floats::<3>(&Semantic::Positions)? else {
            return self.opened.fail(at, "has no positions");
        };
        let positions = points(positions);
        let count = positions.len();
        let (mode, indices) = match (&source.compressed, primitive.indices()) {
            (Some(mesh), _) => (Mode::Triangles, mesh.indices()),
            (None, Some(indices)) => (primitive.mode(), self.opened.indices(&indices, most)?),
            (None, None) => (primitive.mode(), (0..count as u32).collect()),
        };
        self.spend(positions.len() as u64 + indices.len() as u64)?;
        if let Some(index) = indices.iter().find(|&&i| i as usize >= count) {
            let reason = format!("there is no vertex {index}; there are {count}");
            return self.opened.fail(&format!("{at}/indices"), reason);
        }
        let triangles = triangles(mode, &indices);
        let mut normals = match source.floats::<3>(&Semantic::Normals)? {
            Some(normals) => points(normals),
            None => vec![Vec3::ZERO; count],
        };
        for normal in &mut normals {
            *normal = unit_or_zero(*normal);
        }
        if primitive.get(&Semantic::Colors(0)).is_some() {
            self.ignore("colours of vertices");
        }
        let uvs = self.texture_coordinates(&source, count)?;
        if normals.len() != count || uvs.len() != count {
            return self.opened.fail(at, "all attributes must have the same number of elements");
        }
        Ok(Some(compact(Mesh { positions, normals, uvs, triangles })))
    }

    /// Texture coordinates for the base colour texture, else the emission texture, transformed. v points up.
    fn texture_coordinates(
        &mut self,
        source: &Source<'_, '_>,
        count: usize,
    ) -> Result<Vec<Vec2>, SceneError> {
        let material = source.primitive.material();
        let info = base_texture(&material).or_else(|| material.emissive_texture().filter(has_image));
        let transform = info.as_ref().and_then(|info| info.texture_transform());
        let own_set = transform.as_ref().and_then(TextureTransform::tex_coord);
        let set = own_set.or(info.as_ref().map(|info| info.tex_coord())).unwrap_or(0);
        let Some(uvs) = source.floats::<2>(&Semantic::TexCoords(set))? else {
            if info.is_some() {
                self.ignore("textures on faces without texture coordinates (rendered with one texel)");
            }
            return Ok(vec![Vec2::ZERO; count]);
        };
        let mut uvs: Vec<Vec2> = uvs.into_iter().map(Vec2::from_array).collect();
        if let Some(transform) = transform {
            let apply = affine(&transform);
            uvs.iter_mut().for_each(|uv| *uv = apply(*uv));
            if uvs.iter().any(|uv| !uv.is_finite()) {
                return self.opened.fail(source.at, "a transformed texture coordinate is not finite");
            }
        }
        Ok(uvs.into_iter().map(|uv| Vec2::new(uv.x, 1.0 - uv.y)).collect())
    }
}

/// Where the attributes of a primitive are.
struct Source<'a, 'p> {
    opened: &'a Opened,
    primitive: &'a gltf::Primitive<'p>,
    /// The primitive's JSON pointer.
    at: &'a str,
    /// Attributes that are not in accessors.
    compressed: Option<Decoded<'a>>,
    /// Limit on the elements of an accessor.
    most: u64,
}

impl<'r> Reader<'r, '_> {
    /// Decompresses a primitive if it is compressed. Its indices count before that.
    fn source<'a, 'p>(
        &mut self,
        primitive: &'a gltf::Primitive<'p>,
        key: (usize, usize),
        at: &'a str,
        most: u64,
    ) -> Result<Source<'a, 'p>, SceneError>
    where
        'r: 'a,
    {
        let opened = self.opened;
        let mut source = Source { opened, primitive, at, compressed: None, most };
        let Some(compressed) = opened.extensions.meshes.get(&key) else { return Ok(source) };
        let pointer = format!("{at}/extensions/KHR_draco_mesh_compression");
        let Some(indices) = primitive.indices() else {
            return opened.fail(&pointer, "a compressed mesh must have an accessor for its indices");
        };
        let most_indices = indices.count() as u64;
        self.spend(most_indices)?;
        let stream = opened.view(compressed.buffer_view)?;
        let faces = most_indices / 3;
        self.assembly.check_size(&opened.file, faces, 0)?;
        match Decoded::new(stream, &compressed.attributes, faces) {
            Ok(decoded) => source.compressed = Some(decoded),
            Err(reason) => return opened.fail(&pointer, reason),
        }
        Ok(source)
    }
}

impl Source<'_, '_> {
    /// The elements of an attribute. `None` if the primitive has no such attribute.
    fn floats<const N: usize>(&self, semantic: &Semantic) -> Result<Option<Vec<[f32; N]>>, SceneError> {
        let Some(accessor) = self.primitive.get(semantic) else { return Ok(None) };
        let name = semantic.to_string();
        let Some(values) = self.compressed.as_ref().and_then(|mesh| mesh.floats::<N>(&name)) else {
            return self.opened.floats(&accessor, self.most).map(Some);
        };
        let pointer = format!("{}/attributes/{name}", self.at);
        match values {
            Ok(mut values) => {
                if accessor.normalized() {
                    let kind = accessor.data_type();
                    values.iter_mut().flatten().for_each(|value| *value = fraction(*value, kind));
                }
                match values.iter().flatten().position(|value| !value.is_finite()) {
                    Some(i) => self.opened.fail(&pointer, format!("element {} is not finite", i / N)),
                    None => Ok(Some(values)),
                }
            }
            Err(reason) => self.opened.fail(&pointer, reason),
        }
    }
}

/// The function of a `KHR_texture_transform`: scale, rotate, translate. Rotation is counter-clockwise with v
/// pointing down: a quarter turn with offset (0, 1) maps the unit square to itself.
fn affine(transform: &TextureTransform<'_>) -> impl Fn(Vec2) -> Vec2 + use<> {
    let (scale, offset) = (Vec2::from_array(transform.scale()), Vec2::from_array(transform.offset()));
    let (sine, cosine) = (
        libm::sin(f64::from(transform.rotation())) as f32,
        libm::cos(f64::from(transform.rotation())) as f32,
    );
    move |uv| {
        let s = uv * scale;
        Vec2::new(cosine * s.x + sine * s.y, cosine * s.y - sine * s.x) + offset
    }
}

fn points(elements: Vec<[f32; 3]>) -> Vec<Vec3> {
    elements.into_iter().map(Vec3::from_array).collect()
}

/// Triangles in the order and winding of section 3.7.2.1 of the glTF 2.0 specification.
fn triangles(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => {
            let turned =
                |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] };
            indices.windows(3).enumerate().map(turned).collect()
        }
        Mode::TriangleFan => match indices.split_first() {
            Some((&hub, rim)) => rim.windows(2).map(|w| [w[0], w[1], hub]).collect(),
            None => Vec::new(),
        },
        _ => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

/// Removes unused vertices. Exporters often share one large vertex buffer between many primitives.
fn compact(mesh: Mesh) -> Mesh {
    let mut place = vec![u32::MAX; mesh.positions.len()];
    for &vertex in mesh.triangles.iter().flatten() {
        place[vertex as usize] = 0;
    }
    if !place.contains(&u32::MAX) {
        return mesh;
    }
    let mut small = Mesh::default();
    for (old, new) in place.iter_mut().enumerate().filter(|(_, new)| **new == 0) {
        *new = small.positions.len() as u32;
        small.positions.push(mesh.positions[old]);
        small.normals.push(mesh.normals[old]);
        small.uvs.push(mesh.uvs[old]);
    }
    small.triangles = mesh.triangles.iter().map(|t| t.map(|v| place[v as usize])).collect();
    small
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_keep_their_winding() {
        assert_eq!(triangles(Mode::TriangleStrip, &[0, 1, 2, 3]), [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(triangles(Mode::TriangleFan, &[0, 1, 2, 3]), [[1, 2, 0], [2, 3, 0]]);
        assert_eq!(triangles(Mode::Triangles, &[0, 1, 2, 3]), [[0, 1, 2]]);
    }

    #[test]
    fn unused_vertices_are_left_out() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            normals: vec![Vec3::Z; 4],
            uvs: vec![Vec2::ZERO; 4],
            triangles: vec![[3, 1, 2]],
        };
        let small = compact(mesh);
        assert_eq!(small.positions, [Vec3::X, Vec3::Y, Vec3::Z]);
        assert_eq!(small.triangles, [[2, 0, 1]]);
    }
}
