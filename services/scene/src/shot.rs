//! The parts of a scene and their motion, before one frame is "baked": transformed to world space. Nodes form
//! a hierarchy and carry parts, meshes of one stratum.

use crate::animation::Curve;
use crate::error::SceneError;
use crate::limits::LARGEST_COORDINATE;
use crate::tracks::Motion;
use crate::{Geometry, Strata};
use glam::{DMat3, DMat4, DQuat, DVec3, Vec2, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

/// Local geometry, carried by a node.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Mesh {
    #[serde(with = "crate::bulk")]
    pub(crate) positions: Vec<Vec3>,
    /// One per position. Zero means: use the geometric normal.
    #[serde(with = "crate::bulk")]
    pub(crate) normals: Vec<Vec3>,
    /// One per position.
    #[serde(with = "crate::bulk")]
    pub(crate) uvs: Vec<Vec2>,
    #[serde(with = "crate::bulk")]
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// The unit vector along `v`, or zero. In `f64`, because squares of small numbers underflow in `f32`.
pub(crate) fn unit_or_zero(v: Vec3) -> Vec3 {
    v.as_dvec3().normalize_or_zero().as_vec3()
}

/// A node's transform relative to its parent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) enum Placement {
    Matrix(DMat4),
    Parts { translation: DVec3, rotation: DQuat, scale: DVec3 },
}

impl Placement {
    pub(crate) const IDENTITY: Self =
        Self::Parts { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale: DVec3::ONE };

    fn parts(self) -> (DVec3, DQuat, DVec3) {
        match self {
            Placement::Parts { translation, rotation, scale } => (translation, rotation, scale),
            Placement::Matrix(matrix) => {
                let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
                (translation, rotation, scale)
            }
        }
    }
}

/// A named node of the hierarchy, which can be animated.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Node {
    pub(crate) name: String,
    /// Index of the parent, which comes before its children in the list.
    pub(crate) parent: Option<usize>,
    pub(crate) placement: Placement,
    pub(crate) translation: Option<Curve<DVec3>>,
    pub(crate) rotation: Option<Curve<DQuat>>,
    pub(crate) scale: Option<Curve<DVec3>>,
}

impl Node {
    pub(crate) fn new(name: String, parent: Option<usize>, placement: Placement) -> Self {
        Self { name, parent, placement, translation: None, rotation: None, scale: None }
    }

    /// Animates one local property with a curve.
    pub(crate) fn animate(&mut self, motion: Motion) {
        match motion {
            Motion::Translation(curve) => self.translation = Some(curve),
            Motion::Rotation(curve) => self.rotation = Some(curve),
            Motion::Scale(curve) => self.scale = Some(curve),
        }
    }

    fn is_animated(&self) -> bool {
        self.translation.is_some() || self.rotation.is_some() || self.scale.is_some()
    }

    fn moves(&self) -> bool {
        let moving = |c: &Option<Curve<DVec3>>| c.as_ref().is_some_and(|c| !c.is_constant());
        moving(&self.translation)
            || moving(&self.scale)
            || self.rotation.as_ref().is_some_and(|c| !c.is_constant())
    }

    fn local(&self, frame: f64) -> DMat4 {
        match self.placement {
            Placement::Matrix(matrix) if !self.is_animated() => matrix,
            placement => {
                let (translation, rotation, scale) = placement.parts();
                DMat4::from_scale_rotation_translation(
                    self.scale.as_ref().map_or(scale, |c| c.at(frame)),
                    self.rotation.as_ref().map_or(rotation, |c| c.at(frame)),
                    self.translation.as_ref().map_or(translation, |c| c.at(frame)),
                )
            }
        }
    }
}

/// A mesh of one stratum on a node.
#[derive(Debug, Clone)]
pub(crate) struct Part {
    pub(crate) node: usize,
    pub(crate) stratum: u32,
    pub(crate) mesh: Arc<Mesh>,
    /// File of the mesh, for error messages.
    pub(crate) file: Arc<str>,
}

/// All parts of a scene.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(crate) struct Shot {
    pub(crate) nodes: Vec<Node>,
    #[serde(with = "parts_of_meshes")]
    pub(crate) parts: Vec<Part>,
    pub(crate) strata: Strata,
    /// Origin of world space, in the coordinates of the files, metres; see [`Shot::world`].
    pub(crate) origin: DVec3,
    /// While geometry is read.
    #[serde(skip)]
    stratum_by_pair: BTreeMap<(u32, u32), u32>,
    /// Names in use, and the number of objects that were given each name. While geometry is read.
    #[serde(skip)]
    object_names: BTreeMap<String, u32>,
    /// Triangles of all parts, including those without area.
    triangles: u64,
    vertices: u64,
}

/// The geometry of a frame, and where each part is in it.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Baked {
    pub(crate) geometry: Arc<Geometry>,
    /// Vertices and triangles of each part.
    ranges: Vec<(Range<usize>, Range<usize>)>,
    /// Number of triangles that were removed because they have no area.
    pub(crate) dropped: usize,
}

impl Shot {
    /// Adds an object. A taken name gets a number, as in `name (2)`. Returns the id, and whether it was
    /// renamed.
    pub(crate) fn add_object(&mut self, name: &str) -> (u32, bool) {
        let mut unique = name.to_owned();
        // Start at the last number in use: from 2 on would take quadratic time.
        let mut copies = self.object_names.get(name).copied().unwrap_or(0);
        while self.object_names.contains_key(&unique) {
            copies += 1;
            unique = format!("{name} ({copies})");
        }
        let renamed = copies > 0;
        if renamed {
            self.object_names.insert(name.to_owned(), copies);
        }
        self.object_names.insert(unique.clone(), 1);
        self.strata.objects.push(unique);
        (self.strata.objects.len() as u32 - 1, renamed)
    }

    /// The stratum of an (object, material) pair. A new pair gets a new stratum.
    pub(crate) fn stratum(&mut self, object: u32, material: u32) -> u32 {
        *self.stratum_by_pair.entry((object, material)).or_insert_with(|| {
            self.strata.pairs.push((object, material));
            self.strata.pairs.len() as u32 - 1
        })
    }

    /// Adds a part.
    pub(crate) fn add_part(&mut self, part: Part) {
        self.triangles += part.mesh.triangles.len() as u64;
        self.vertices += part.mesh.positions.len() as u64;
        self.parts.push(part);
    }

    /// Nodes by name. Of several with one name, it is the one with geometry. The value is `None` if several
    /// of them have geometry, or none has.
    pub(crate) fn nodes_by_name(&self) -> BTreeMap<&str, Option<usize>> {
        let named = |nodes: &mut dyn Iterator<Item = usize>| {
            let mut found = BTreeMap::new();
            for node in nodes {
                let name = self.nodes[node].name.as_str();
                found.entry(name).and_modify(|known| *known = None).or_insert(Some(node));
            }
            found
        };
        let with_geometry: BTreeSet<usize> = self.parts.iter().map(|part| part.node).collect();
        let mut found = named(&mut (0..self.nodes.len()));
        found.extend(named(&mut with_geometry.into_iter()));
        found
    }

    /// Number of triangles, including those without area.
    pub(crate) fn triangle_count(&self) -> u64 {
        self.triangles
    }

    /// Number of vertices.
    pub(crate) fn vertex_count(&self) -> u64 {
        self.vertices
    }

    /// World matrix of every node at a frame, relative to [`Shot::origin`].
    pub(crate) fn world(&self, frame: f64) -> Vec<DMat4> {
        let mut world: Vec<DMat4> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let local = node.local(frame);
            let root = |local| DMat4::from_translation(-self.origin) * local;
            world.push(node.parent.map_or_else(|| root(local), |parent| world[parent] * local));
        }
        world
    }

    /// For each node, whether it or an ancestor moves during the shot.
    pub(crate) fn moving(&self) -> Vec<bool> {
        let mut moving: Vec<bool> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            moving.push(node.moves() || node.parent.is_some_and(|parent| moving[parent]));
        }
        moving
    }

    /// Computes all geometry in world space.
    pub(crate) fn bake(&self, world: &[DMat4]) -> Result<Baked, SceneError> {
        let (vertices, triangles) = (self.vertex_count() as usize, self.triangle_count() as usize);
        let mut geometry = Geometry {
            positions: Vec::with_capacity(vertices),
            normals: Vec::with_capacity(vertices),
            uvs: Vec::with_capacity(vertices),
            triangles: Vec::with_capacity(triangles),
            triangle_stratum: Vec::with_capacity(triangles),
            strata: self.strata.clone(),
        };
        let mut ranges = Vec::with_capacity(self.parts.len());
        for part in &self.parts {
            let to_world = ToWorld::new(&world[part.node]);
            let first = geometry.positions.len();
            for &position in &part.mesh.positions {
                geometry.positions.push(to_world.position(position));
            }
            geometry.normals.extend(part.mesh.normals.iter().map(|&n| to_world.normal(n)));
            geometry.uvs.extend_from_slice(&part.mesh.uvs);
            self.check_positions(part, &geometry.positions[first..])?;
            let triangles = push_triangles(&mut geometry, part, first as u32, to_world.mirrored);
            ranges.push((first..geometry.positions.len(), triangles));
        }
        let dropped = triangles - geometry.triangles.len();
        Ok(Baked { geometry: Arc::new(geometry), ranges, dropped })
    }

    /// Like `bake`, but computes only the parts on moving nodes. The other parts come from `still`.
    pub(crate) fn bake_moving(
        &self,
        world: &[DMat4],
        moving: &[bool],
        still: &Baked,
    ) -> Result<Geometry, SceneError> {
        let base = &still.geometry;
        let mut geometry = Geometry {
            positions: base.positions.clone(),
            normals: base.normals.clone(),
            uvs: base.uvs.clone(),
            triangles: Vec::with_capacity(base.triangles.len()),
            triangle_stratum: Vec::with_capacity(base.triangles.len()),
            strata: base.strata.clone(),
        };
        for (part, (vertices, triangles)) in self.parts.iter().zip(&still.ranges) {
            if moving[part.node] {
                let to_world = ToWorld::new(&world[part.node]);
                for (out, &local) in geometry.positions[vertices.clone()].iter_mut().zip(&part.mesh.positions)
                {
                    *out = to_world.position(local);
                }
                for (out, &local) in geometry.normals[vertices.clone()].iter_mut().zip(&part.mesh.normals) {
                    *out = to_world.normal(local);
                }
                self.check_positions(part, &geometry.positions[vertices.clone()])?;
                push_triangles(&mut geometry, part, vertices.start as u32, to_world.mirrored);
            } else {
                geometry.triangles.extend_from_slice(&base.triangles[triangles.clone()]);
                geometry.triangle_stratum.extend_from_slice(&base.triangle_stratum[triangles.clone()]);
            }
        }
        Ok(geometry)
    }

    /// Forgets the meshes of parts that never move. Frames take these parts from the baked geometry.
    pub(crate) fn forget_still(&mut self, moving: &[bool]) {
        let nothing = Arc::<Mesh>::default();
        self.parts.iter_mut().filter(|part| !moving[part.node]).for_each(|part| part.mesh = nothing.clone());
    }

    fn check_positions(&self, part: &Part, positions: &[Vec3]) -> Result<(), SceneError> {
        // NaN counts as outside.
        let inside = |p: &Vec3| p.abs().max_element() <= LARGEST_COORDINATE as f32 && p.is_finite();
        match positions.iter().position(|p| !inside(p)) {
            None => Ok(()),
            Some(i) => {
                let name = &self.nodes[part.node].name;
                let reason = format!(
                    "vertex {i} of `{name}` is not within {LARGEST_COORDINATE:e} m of the origin in world space"
                );
                Err(SceneError::file(part.file.as_ref(), reason))
            }
        }
    }
}

/// Adds a part's triangles that have an area. The winding of a mirrored part is reversed.
fn push_triangles(geometry: &mut Geometry, part: &Part, first: u32, mirrored: bool) -> Range<usize> {
    let start = geometry.triangles.len();
    for &[a, b, c] in &part.mesh.triangles {
        let [b, c] = if mirrored { [c, b] } else { [b, c] };
        let index = geometry.triangles.len() as u32;
        geometry.triangles.push([first + a, first + b, first + c]);
        if geometry.geometric_normal(index) == Vec3::ZERO {
            geometry.triangles.pop();
        }
    }
    geometry.triangle_stratum.resize(geometry.triangles.len(), part.stratum);
    start..geometry.triangles.len()
}

/// A node's world matrix, prepared for points and normals.
struct ToWorld {
    matrix: DMat4,
    /// The inverse transpose up to a positive factor, which always exists: cofactors times the determinant's
    /// sign.
    normals: DMat3,
    mirrored: bool,
    identity: bool,
}

impl ToWorld {
    fn new(matrix: &DMat4) -> Self {
        let m = DMat3::from_mat4(*matrix);
        let mirrored = m.determinant() < 0.0;
        let cofactors =
            DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
        let normals = if mirrored { -cofactors } else { cofactors };
        Self { matrix: *matrix, normals, mirrored, identity: *matrix == DMat4::IDENTITY }
    }

    fn position(&self, local: Vec3) -> Vec3 {
        if self.identity { local } else { self.matrix.transform_point3(local.as_dvec3()).as_vec3() }
    }

    fn normal(&self, local: Vec3) -> Vec3 {
        if self.identity { local } else { (self.normals * local.as_dvec3()).normalize_or_zero().as_vec3() }
    }
}

/// Parts in a kept scene. A mesh that several parts share is written once.
mod parts_of_meshes {
    use super::{Mesh, Part};
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
    use std::sync::Arc;

    /// Indices of node, stratum, mesh and file.
    type Indices = (usize, u32, usize, usize);

    pub fn serialize<S: Serializer>(parts: &[Part], serializer: S) -> Result<S::Ok, S::Error> {
        let (mut meshes, mut files): (Vec<&Arc<Mesh>>, Vec<&Arc<str>>) = Default::default();
        let mut indices: Vec<Indices> = Vec::with_capacity(parts.len());
        let mut known = std::collections::HashMap::new();
        for Part { node, stratum, mesh, file } in parts {
            let mesh = *known.entry(Arc::as_ptr(mesh)).or_insert_with(|| {
                meshes.push(mesh);
                meshes.len() - 1
            });
            // Parts come file by file.
            if files.last().is_none_or(|last| *last != file) {
                files.push(file);
            }
            indices.push((*node, *stratum, mesh, files.len() - 1));
        }
        (indices, meshes, files).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Part>, D::Error> {
        let (indices, meshes, files) =
            <(Vec<Indices>, Vec<Arc<Mesh>>, Vec<Arc<str>>)>::deserialize(deserializer)?;
        let part = |(node, stratum, mesh, file): Indices| {
            Some(Part { node, stratum, mesh: meshes.get(mesh)?.clone(), file: files.get(file)?.clone() })
        };
        let parts: Option<Vec<Part>> = indices.into_iter().map(part).collect();
        parts.ok_or_else(|| D::Error::custom("a part without mesh or file"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::animation::Interpolation;

    fn quad() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            normals: vec![Vec3::Z; 4],
            uvs: vec![Vec2::ZERO; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    fn shot(placement: Placement) -> Shot {
        let mut shot = Shot::default();
        let (object, _) = shot.add_object("quad");
        let stratum = shot.stratum(object, 0);
        shot.nodes.push(Node::new("quad".into(), None, placement));
        shot.add_part(Part { node: 0, stratum, mesh: Arc::new(quad()), file: "test".into() });
        shot
    }

    #[test]
    fn the_front_of_a_mirrored_part_stays_its_front() {
        for scale in [DVec3::new(-2.0, 1.0, 1.0), DVec3::new(1.0, 1.0, -3.0), DVec3::new(-1.0, -1.0, -1.0)] {
            let geometry = {
                let shot = shot(Placement::Matrix(DMat4::from_scale(scale)));
                shot.bake(&shot.world(0.0)).unwrap().geometry
            };
            let expected = Vec3::new(0.0, 0.0, scale.z.signum() as f32);
            for t in 0..2 {
                assert_eq!(geometry.geometric_normal(t), expected, "{scale}");
            }
            assert!(geometry.normals.iter().all(|n| *n == expected), "{scale}");
        }
    }

    #[test]
    fn normals_stay_perpendicular_under_uneven_scale() {
        let mut shot = shot(Placement::Matrix(
            DMat4::from_scale(DVec3::new(1.0, 5.0, 0.5)) * DMat4::from_rotation_x(0.7),
        ));
        shot.nodes[0].name = "tilted".into();
        let geometry = shot.bake(&shot.world(0.0)).unwrap().geometry;
        let along = geometry.geometric_normal(0).dot(geometry.normals[0]);
        assert!((along - 1.0).abs() < 1e-6, "{along}");
    }

    #[test]
    fn a_part_whose_scale_passes_zero_has_no_triangles_in_that_frame() {
        let mut shot = shot(Placement::IDENTITY);
        let scales = vec![DVec3::ONE, -DVec3::ONE];
        shot.nodes[0].scale = Curve::new(vec![0.0, 2.0], scales, Interpolation::Linear);
        let (moving, still) = (shot.moving(), shot.bake(&shot.world(0.0)).unwrap());
        let at = |frame| shot.bake_moving(&shot.world(frame), &moving, &still).unwrap();
        assert_eq!((at(0.0).triangles.len(), at(1.0).triangles.len(), at(2.0).triangles.len()), (2, 0, 2));
        assert_eq!(at(0.0), *still.geometry);
        assert_eq!(at(1.0).strata, still.geometry.strata);
    }

    #[test]
    fn children_move_with_their_parents() {
        let mut shot = shot(Placement::IDENTITY);
        shot.nodes.push(shot.nodes[0].clone());
        shot.nodes[1].parent = Some(0);
        shot.parts[0].node = 1;
        let half_turn = DQuat::from_rotation_y(std::f64::consts::PI);
        shot.nodes[0].rotation =
            Curve::new(vec![0.0, 1.0], vec![DQuat::IDENTITY, half_turn], Interpolation::Step);
        assert_eq!(shot.moving(), [true, true]);
        let geometry = shot.bake(&shot.world(1.0)).unwrap().geometry;
        assert!((geometry.positions[1] + Vec3::X).length() < 1e-6);
    }

    #[test]
    fn equal_names_become_distinct() {
        let mut shot = Shot::default();
        assert_eq!(shot.add_object("a"), (0, false));
        assert_eq!(shot.add_object("a"), (1, true));
        assert_eq!(shot.add_object("a"), (2, true));
        assert_eq!(shot.strata.objects, ["a", "a (2)", "a (3)"]);
    }
}
