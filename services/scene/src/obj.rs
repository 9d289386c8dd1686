//! Reads OBJ geometry, with `tobj`.
//!
//! `tobj` gives no line numbers, accepts NaN, does not report missing materials, fans non-convex faces, and
//! mixes up attributes that only some faces have. So [`check`] goes through the text first: non-convex
//! faces are triangulated, and a new model starts where attributes change. `tobj` reads what [`check`]
//! writes at the same time, on another thread.

use crate::assembly::{Assembly, plain_material};
use crate::bundle::{Bundle, resolve};
use crate::error::{Place, SceneError};
use crate::obj_text::{PipedText, file_names, piped_text, text, without_comment};
use crate::polygon;
use crate::shot::{Mesh, Node, Part, Placement, unit_or_zero};
use crate::{Color, Surface};
use glam::{DVec3, Vec2, Vec3};
use std::collections::{BTreeMap, BTreeSet};
use std::io::BufRead;
use std::sync::Arc;

/// The name that `tobj` gives to faces before the first `o` or `g`.
const UNNAMED: &str = "unnamed_object";

/// Limit on the sum of squared corner counts of non-convex faces, half a minute of ear clipping.
const MOST_CUTTING: u64 = 1_000_000_000;

/// A checked OBJ file.
struct Checked {
    /// Paths of the material libraries, each once, with the line that first names it.
    libraries: Vec<(String, usize)>,
    /// Materials in use, each with the line that first uses it.
    materials: BTreeMap<String, usize>,
    /// Unsupported keys, and the number of times that each occurs.
    ignored: BTreeMap<String, usize>,
    /// Number of faces with fewer than 3 corners.
    small_faces: usize,
    /// Largest coordinate.
    farthest: f32,
}

/// Coordinates are 32-bit floats. Beyond this distance, in metres, they are steps of 8 millimetres and more.
const FAR: f32 = 65_536.0;

/// Reads an OBJ file and its material libraries into the assembly.
pub(crate) fn load(assembly: &mut Assembly<'_>, path: &str) -> Result<(), SceneError> {
    let bytes = assembly.bundle.read(path)?;
    let bundle = assembly.bundle;
    let (canonical, reader) = piped_text();
    let (checked, parsed) =
        forelight_threads::join(|| check(bundle, path, &bytes, canonical), || parse(reader));
    let checked = checked?;
    warn_counted(assembly, path, "these keys are ignored", &checked.ignored);
    if checked.small_faces > 0 {
        let count = checked.small_faces;
        assembly.warn(format!("{path}: faces of fewer than 3 corners are left out ({count}×)"));
    }
    if checked.farthest > FAR {
        let (far, step) = (checked.farthest, 1000.0 * (checked.farthest.next_up() - checked.farthest));
        assembly.warn(format!(
            "{path}: vertices are {far:.0} m from the origin, where coordinates have steps of {step:.0} mm; move the \
             model to the origin"
        ));
    }
    let libraries = load_libraries(assembly, path, &checked.libraries)?;
    let mut sources: Vec<(String, tobj::Material)> = Vec::new();
    // Of materials with the same name, the last counts.
    let mut places: BTreeMap<&str, usize> = BTreeMap::new();
    for (file, (materials, index)) in &libraries {
        places.extend(index.iter().map(|(name, place)| (name.as_str(), sources.len() + place)));
        sources.extend(materials.iter().map(|material| (file.clone(), material.clone())));
    }
    // Without a library, `usemtl` is a leftover.
    let named = if libraries.is_empty() { BTreeMap::new() } else { checked.materials };
    for (name, line) in &named {
        if !places.contains_key(name.as_str()) {
            return Err(SceneError::line(
                path,
                *line,
                format!("no material library has a material `{name}`"),
            ));
        }
    }
    let (models, used) = parsed.map_err(|e| SceneError::file(path, e.to_string()))?;
    if models.iter().all(|model| model.mesh.indices.is_empty()) {
        return Err(SceneError::file(path, "has no face"));
    }

    let textures = sources
        .iter()
        .filter_map(|(file, source)| crate::bundle::resolve(file, source.diffuse_texture.as_ref()?).ok());
    assembly.textures.prefetch(textures);
    let first_material = assembly.materials.len();
    for (file, source) in &sources {
        let material = crate::mtl::material(assembly, file, source)?;
        assembly.add_material(material);
        assembly.check_priorities(file)?;
    }
    // All materials in use are known by now, or none is.
    let used = used.iter().filter_map(|material| places.get(material.name.as_str()));
    let used: Vec<u32> = used.map(|place| (first_material + place) as u32).collect();
    place(assembly, path, models, &used)
}

/// Models, whose materials are indices into the materials in use, by name.
type Parsed = (Vec<tobj::Model>, Vec<tobj::Material>);

/// Has `tobj` read the text of [`check`]. In it, a library holds one material: the one that it is named
/// after.
fn parse(mut text: impl BufRead) -> Result<Parsed, tobj::LoadError> {
    let options =
        tobj::LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };
    let (models, used) = tobj::load_obj_buf(&mut text, &options, |library| {
        let name = library.to_str().unwrap_or_default().to_owned();
        let material = tobj::Material { name: name.clone(), ..tobj::Material::default() };
        Ok((vec![material], LibraryIndex::from([(name, 0)])))
    })?;
    Ok((models, used?))
}

/// A material library: its path in the bundle, and its content as read by `tobj`.
type Library = (String, (Vec<tobj::Material>, LibraryIndex));
/// The index from names to positions that `tobj` returns.
type LibraryIndex = std::collections::HashMap<String, usize>;

fn load_libraries(
    assembly: &mut Assembly<'_>,
    path: &str,
    named: &[(String, usize)],
) -> Result<Vec<Library>, SceneError> {
    let mut libraries: Vec<Library> = Vec::new();
    for (file, line) in named {
        let bytes = assembly.bundle.read(file).map_err(|e| e.within(path, Place::Line(*line), "`mtllib`"))?;
        let checked = crate::mtl::check(file, &bytes)?;
        warn_counted(assembly, file, "these keys are ignored", &checked.ignored);
        warn_counted(assembly, file, "not fully supported", &checked.simplified);
        let library = tobj::load_mtl_buf(&mut checked.canonical.as_bytes())
            .map_err(|e| SceneError::file(file, e.to_string()))?;
        libraries.push((file.clone(), library));
    }
    Ok(libraries)
}

/// Converts models to parts. Models with the same name are one object, which may have several materials.
fn place(
    assembly: &mut Assembly<'_>,
    path: &str,
    models: Vec<tobj::Model>,
    used: &[u32],
) -> Result<(), SceneError> {
    let file: Arc<str> = path.into();
    let mut objects: BTreeMap<String, (u32, usize)> = BTreeMap::new();
    let mut grey = None;
    for tobj::Model { mesh, name } in models {
        if mesh.indices.is_empty() {
            continue;
        }
        assembly.check_size(path, mesh.indices.len() as u64 / 3, mesh.positions.len() as u64 / 3)?;
        let (object, node) = match objects.get(&name) {
            Some(&known) => known,
            None => {
                let (object, renamed) = assembly.shot.add_object(&name);
                let unique = assembly.shot.strata.objects[object as usize].clone();
                if renamed {
                    assembly
                        .warn(format!("{path}: another file has an object `{name}`; this one is `{unique}`"));
                }
                assembly.shot.nodes.push(Node::new(unique, None, Placement::IDENTITY));
                let node = assembly.shot.nodes.len() - 1;
                objects.insert(name.clone(), (object, node));
                (object, node)
            }
        };
        let material = match mesh.material_id.and_then(|id| used.get(id)) {
            Some(&material) => material,
            None => *grey.get_or_insert_with(|| {
                assembly.warn(format!("{path}: faces of `{name}` have no material and are rendered grey"));
                let albedo = Color::plain(Vec3::splat(0.5));
                assembly.add_material(plain_material("(no material)", Surface::Lambert { albedo }))
            }),
        };
        let stratum = assembly.shot.stratum(object, material);
        let mesh = Arc::new(local_mesh(&mesh));
        assembly.shot.add_part(Part { node, stratum, mesh, file: file.clone() });
    }
    Ok(())
}

fn local_mesh(mesh: &tobj::Mesh) -> Mesh {
    let triples = |flat: &[f32]| flat.chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
    let positions = triples(&mesh.positions);
    let mut normals = triples(&mesh.normals);
    for normal in &mut normals {
        *normal = unit_or_zero(*normal);
    }
    normals.resize(positions.len(), Vec3::ZERO);
    let mut uvs: Vec<Vec2> = mesh.texcoords.chunks_exact(2).map(Vec2::from_slice).collect();
    uvs.resize(positions.len(), Vec2::ZERO);
    let triangles = mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    Mesh { positions, normals, uvs, triangles }
}

/// Gives one warning for all counted things of a file, if there are any.
fn warn_counted(assembly: &mut Assembly<'_>, file: &str, what: &str, counted: &BTreeMap<String, usize>) {
    if !counted.is_empty() {
        let things: Vec<String> =
            counted.iter().map(|(thing, count)| format!("`{thing}` ({count}×)")).collect();
        assembly.warn(format!("{file}: {what}: {}", things.join(", ")));
    }
}

/// Checks an OBJ file, and writes the text that `tobj` reads.
fn check(bundle: &Bundle, file: &str, bytes: &[u8], out: PipedText) -> Result<Checked, SceneError> {
    let text = text(file, bytes)?;
    let triangle_limit = bundle.limits().triangles;
    let mut check = Check {
        bundle,
        file,
        out,
        name: UNNAMED,
        format: None,
        positions: Vec::new(),
        counts: [0; 2],
        triangles: 0,
        cutting: 0,
        libraries: Vec::new(),
        known_libraries: BTreeSet::new(),
        misses_library: false,
        materials: BTreeMap::new(),
        ignored: BTreeMap::new(),
        small_faces: 0,
        farthest: 0.0,
    };
    for (i, line) in text.lines().enumerate() {
        check.line(line.trim(), i + 1).map_err(|reason| SceneError::line(file, i + 1, reason))?;
        if check.triangles > triangle_limit {
            let (found, limit) = (check.triangles, triangle_limit);
            return Err(SceneError::Limit { file: file.to_owned(), what: "triangles", found, limit });
        }
    }
    let Check { libraries, materials, ignored, small_faces, farthest, .. } = check;
    Ok(Checked { libraries, materials, ignored, small_faces, farthest })
}

struct Check<'a> {
    bundle: &'a Bundle,
    /// Path of the OBJ file.
    file: &'a str,
    out: PipedText,
    /// Name of the current object.
    name: &'a str,
    /// Whether the current model's faces have (texture coordinates, normals).
    format: Option<(bool, bool)>,
    /// Positions so far.
    positions: Vec<[f32; 3]>,
    /// Number of texture coordinates and normals so far.
    counts: [usize; 2],
    triangles: u64,
    /// Sum of the squared corner counts of the non-convex faces so far.
    cutting: u64,
    libraries: Vec<(String, usize)>,
    known_libraries: BTreeSet<String>,
    /// Whether the last of the libraries is no file of the bundle.
    misses_library: bool,
    materials: BTreeMap<String, usize>,
    ignored: BTreeMap<String, usize>,
    small_faces: usize,
    farthest: f32,
}

impl<'a> Check<'a> {
    fn line(&mut self, line: &'a str, number: usize) -> Result<(), String> {
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = if matches!(key, "v" | "vt" | "vn" | "f") { without_comment(rest) } else { rest }.trim();
        match key {
            "" | "s" => {}
            "v" => self.position(rest)?,
            "vt" => {
                let (words, _) = numbers::<3>("vt", rest, 1)?;
                self.counts[0] += 1;
                let v = if words == 1 { " 0" } else { "" };
                self.write(&["vt ", rest, v]);
            }
            "vn" => {
                numbers::<3>("vn", rest, 3)?;
                self.counts[1] += 1;
                self.write(&["vn ", rest]);
            }
            "f" => self.face(rest)?,
            "o" | "g" => {
                self.name = if rest.is_empty() { UNNAMED } else { rest };
                self.format = None;
                self.write(&["o ", self.name]);
            }
            "usemtl" | "mtllib" if rest.is_empty() => return Err(format!("`{key}` needs a name")),
            "usemtl" => {
                // A file may name its libraries after the faces that use them, but `tobj` needs each material
                // before. So each comes as a library of its own.
                if !self.materials.contains_key(rest) {
                    self.materials.insert(rest.to_owned(), number);
                    self.write(&["mtllib ", rest]);
                }
                self.write(&["usemtl ", rest]);
            }
            "mtllib" => self.libraries(rest, number)?,
            _ if key.starts_with('#') => {}
            _ => *self.ignored.entry(key.to_owned()).or_insert(0) += 1,
        }
        Ok(())
    }

    /// Reads the names of material libraries.
    fn libraries(&mut self, rest: &str, number: usize) -> Result<(), String> {
        // The first one that is missing will be the error. A hostile file may name very many.
        if self.misses_library {
            return Ok(());
        }
        let is_known = |path: &String| self.known_libraries.contains(path) || self.bundle.contains(path);
        let is_file = |name: &str| resolve(self.file, name).is_ok_and(|path| is_known(&path));
        for name in file_names(rest, is_file) {
            // `tobj` would read a library as often as it is named, and count its materials each time.
            let library = resolve(self.file, name).map_err(|reason| format!("`mtllib`: {reason}"))?;
            if self.known_libraries.insert(library.clone()) {
                self.misses_library = !self.bundle.contains(&library);
                self.libraries.push((library, number));
            }
            if self.misses_library {
                break;
            }
        }
        Ok(())
    }

    fn write(&mut self, parts: &[&str]) {
        self.out.line(parts);
    }

    /// Reads a position: 3 numbers, or 4 with a weight, or 6 with a colour. The colour is ignored.
    fn position(&mut self, rest: &str) -> Result<(), String> {
        let (words, [x, y, z, weight, ..]) = numbers::<6>("v", rest, 3)?;
        let weight = if words == 4 { weight } else { 1.0 };
        let position = [x, y, z].map(|coordinate| coordinate / weight);
        self.farthest = position.iter().fold(self.farthest, |far, coordinate| far.max(coordinate.abs()));
        self.positions.push(position);
        match words {
            3 => self.write(&["v ", rest]),
            4 if weight == 0.0 => return Err("`v`: the weight is zero".into()),
            4 => self.write(&["v ", rest]),
            6 => {
                let words: Vec<&str> = rest.split_whitespace().take(3).collect();
                self.write(&["v ", &words.join(" ")]);
            }
            other => return Err(format!("`v` takes 3 numbers, not {other}")),
        }
        Ok(())
    }

    fn face(&mut self, rest: &str) -> Result<(), String> {
        let mut corners: Vec<usize> = Vec::new();
        let mut format = None;
        for corner in rest.split_whitespace() {
            let mut has = [None; 3];
            let mut indices = corner.split('/');
            for (kind, has) in has.iter_mut().enumerate() {
                if let Some(index) = indices.next().filter(|index| !index.is_empty()) {
                    *has = Some(self.index(kind, index)?);
                }
            }
            let (Some(position), None) = (has[0], indices.next()) else {
                return Err(format!("`f`: `{corner}` is not `v`, `v/vt`, `v//vn` or `v/vt/vn`"));
            };
            let has = (has[1].is_some(), has[2].is_some());
            if *format.get_or_insert(has) != has {
                return Err("`f`: all corners must have the same attributes".into());
            }
            corners.push(position);
        }
        if corners.len() < 3 {
            self.small_faces += 1;
            return Ok(());
        }
        if self.format.is_some() && self.format != format {
            self.write(&["o ", self.name]);
        }
        self.format = format;
        self.triangles += corners.len() as u64 - 2;
        let ears = if corners.len() == 3 { None } else { self.ears(&corners)? };
        match ears {
            None => self.write(&["f ", rest]),
            Some(ears) => {
                let words: Vec<&str> = rest.split_whitespace().collect();
                for [a, b, c] in ears {
                    self.write(&["f ", words[a], " ", words[b], " ", words[c]]);
                }
            }
        }
        Ok(())
    }

    /// The triangles of a non-convex face. `None` if the face is convex.
    fn ears(&mut self, corners: &[usize]) -> Result<Option<Vec<[usize; 3]>>, String> {
        let corners: Vec<DVec3> =
            corners.iter().map(|&corner| DVec3::from(self.positions[corner].map(f64::from))).collect();
        if polygon::is_fan(&corners) {
            return Ok(None);
        }
        let corners_squared = (corners.len() as u64).saturating_mul(corners.len() as u64);
        self.cutting = self.cutting.saturating_add(corners_squared);
        if self.cutting > MOST_CUTTING {
            return Err(
                "`f`: the non-convex faces have too many corners to triangulate here; triangulate them in the exporter".into()
            );
        }
        Ok(polygon::ears(&corners))
    }

    /// Parses an index, from 1 or negative from the last element. Returns it counted from 0.
    fn index(&self, kind: usize, text: &str) -> Result<usize, String> {
        let count = [self.positions.len(), self.counts[0], self.counts[1]][kind];
        let index: i64 = text.parse().map_err(|_| format!("`f`: `{text}` is not an index"))?;
        if index == 0 || index.unsigned_abs() > count as u64 {
            let what = ["vertex", "texture coordinate", "normal"][kind];
            return Err(format!("`f`: there is no {what} {index}; there are {count} so far"));
        }
        // Both numbers are at most the number of lines.
        let distance = index.unsigned_abs() as usize;
        Ok(if index > 0 { distance - 1 } else { count - distance })
    }
}

/// Parses `least` to `N` finite numbers. Returns their count, and the numbers followed by zeros.
fn numbers<const N: usize>(key: &str, text: &str, least: usize) -> Result<(usize, [f32; N]), String> {
    let mut count = 0;
    let mut found = [0.0; N];
    for word in text.split_whitespace() {
        let value: f32 = word.parse().map_err(|_| format!("`{key}`: `{word}` is not a number"))?;
        if !value.is_finite() {
            return Err(format!("`{key}`: {word} is not finite"));
        }
        if let Some(place) = found.get_mut(count) {
            *place = value;
        }
        count += 1;
    }
    if count < least || count > N {
        return Err(format!("`{key}` takes {least} to {N} numbers, not {count}"));
    }
    Ok((count, found))
}
