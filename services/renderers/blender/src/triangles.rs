//! What the driver hands out of a frame as triangles, and the frame that a preview draws from them.

use crate::image::Stratum;
use forelight_renderer::door::{Cost, RendererError};
use forelight_scene::{Camera, Color, Environment, Frame, Geometry, Material, Strata, Surface};
use glam::{Vec2, Vec3};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Answer of the driver to a question for triangles.
#[derive(Deserialize)]
pub(crate) struct Answer {
    pub cost: Cost,
    #[serde(flatten)]
    pub outcome: Outcome,
}

#[derive(Deserialize)]
#[serde(untagged)]
pub(crate) enum Outcome {
    /// Triangles do not show what is rendered: the reason.
    Refused { refused: String },
    /// What changed since the step before.
    Step(Step),
}

/// What changed from one frame to the next.
#[derive(Deserialize)]
pub(crate) struct Step {
    /// Its name. The next question refers to it.
    pub step: String,
    /// Whether everything is written, because the step before is not known.
    whole: bool,
    camera: View,
    /// Pieces in the file, in order.
    written: Vec<Written>,
    /// Pieces that are no longer shown.
    gone: Vec<u64>,
}

#[derive(Deserialize)]
struct View {
    origin: Vec3,
    right: Vec3,
    up: Vec3,
    forward: Vec3,
    tan_half_x: f32,
    tan_half_y: f32,
}

/// A piece in the file.
#[derive(Deserialize)]
struct Written {
    piece: u64,
    /// Index of its object in the description, -1 for none.
    object: i64,
    vertices: usize,
    triangles: usize,
}

/// An object as evaluated in a frame, or an instance of it.
struct Piece {
    object: Option<u32>,
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    /// Material of each triangle.
    materials: Vec<Option<u32>>,
}

/// Everything that is shown, from frame to frame.
pub(crate) struct Pieces {
    step: Option<String>,
    pieces: BTreeMap<u64, Piece>,
    geometry: Arc<Geometry>,
    /// Object and material of each stratum of the geometry.
    pairs: Vec<Stratum>,
    materials: Arc<[Material]>,
}

impl Pieces {
    pub fn new() -> Self {
        Self {
            step: None,
            pieces: BTreeMap::new(),
            geometry: Arc::default(),
            pairs: Vec::new(),
            materials: [opaque()].into(),
        }
    }

    /// The last step, to which the next question refers.
    pub fn step(&self) -> Option<&str> {
        self.step.as_deref()
    }

    /// Object and material of a stratum. Nothing where no surface is.
    pub fn pair(&self, stratum: u32) -> Stratum {
        self.pairs.get(stratum as usize).copied().unwrap_or_default()
    }

    /// Takes what a step wrote into a file, and returns the frame for an image of this size.
    pub fn advance(
        &mut self,
        step: Step,
        file: &Path,
        (width, height): (u32, u32),
    ) -> Result<Frame, RendererError> {
        let is_changed = step.whole || !step.written.is_empty() || !step.gone.is_empty();
        if is_changed {
            self.read(&step, file)?;
            self.assemble()?;
        }
        self.step = Some(step.step);
        let View { origin, right, up, forward, tan_half_x, tan_half_y } = step.camera;
        Ok(Frame {
            number: 0,
            camera: Camera {
                origin,
                right,
                up,
                forward,
                tan_half_x,
                tan_half_y,
                width,
                height,
                aperture_radius: 0.0,
                focus_distance: 1.0,
            },
            geometry: Arc::clone(&self.geometry),
            materials: Arc::clone(&self.materials),
            textures: Arc::default(),
            points: Vec::new(),
            suns: Vec::new(),
            environment: Environment::Black,
        })
    }

    fn read(&mut self, step: &Step, file: &Path) -> Result<(), RendererError> {
        let bytes = std::fs::read(file).map_err(RendererError::io(file))?;
        let size = |written: &Written| {
            let triangles = written.triangles.checked_mul(4 * size_of::<u32>())?;
            written.vertices.checked_mul(size_of::<Vec3>())?.checked_add(triangles)
        };
        let sizes: Option<Vec<usize>> = step.written.iter().map(size).collect();
        let expected = sizes.and_then(|sizes| sizes.into_iter().try_fold(0usize, usize::checked_add));
        if expected != Some(bytes.len()) {
            return Err(RendererError::Answer("the file of triangles has another size".to_owned()));
        }
        if step.whole {
            self.pieces.clear();
        }
        for gone in &step.gone {
            self.pieces.remove(gone);
        }
        let mut words = bytes.as_chunks().0.iter().copied();
        for written in &step.written {
            let piece = written.read(&mut words)?;
            self.pieces.insert(written.piece, piece);
        }
        Ok(())
    }

    /// Joins all pieces.
    fn assemble(&mut self) -> Result<(), RendererError> {
        let too_many = |_| RendererError::Answer("the frame has too many vertices".to_owned());
        let mut geometry = Geometry::default();
        let mut numbers = BTreeMap::new();
        for piece in self.pieces.values() {
            let start = u32::try_from(geometry.positions.len()).map_err(too_many)?;
            u32::try_from(geometry.positions.len() + piece.positions.len()).map_err(too_many)?;
            geometry.positions.extend(&piece.positions);
            geometry
                .triangles
                .extend(piece.triangles.iter().map(|corners| corners.map(|corner| start + corner)));
            for &material in &piece.materials {
                let next = numbers.len() as u32;
                let stratum = *numbers.entry((piece.object, material)).or_insert(next);
                geometry.triangle_stratum.push(stratum);
            }
        }
        self.pairs = vec![(None, None); numbers.len()];
        for (pair, stratum) in numbers {
            self.pairs[stratum as usize] = pair;
        }
        geometry.normals = vec![Vec3::ZERO; geometry.positions.len()];
        geometry.uvs = vec![Vec2::ZERO; geometry.positions.len()];
        // All have the one opaque material. What they are made of is in `pairs`.
        geometry.strata =
            Strata { objects: Vec::new(), pairs: (0..self.pairs.len() as u32).map(|s| (s, 0)).collect() };
        self.geometry = Arc::new(geometry);
        Ok(())
    }
}

impl Written {
    /// Reads a piece, without triangles that have no area or are not finite.
    fn read(&self, words: &mut impl Iterator<Item = [u8; 4]>) -> Result<Piece, RendererError> {
        let mut word = || words.next().unwrap_or_default();
        let mut positions: Vec<Vec3> = (0..self.vertices)
            .map(|_| Vec3::from_array([(); 3].map(|()| f32::from_le_bytes(word()))))
            .collect();
        let corners: Vec<[u32; 3]> =
            (0..self.triangles).map(|_| [(); 3].map(|()| u32::from_le_bytes(word()))).collect();
        let materials: Vec<Option<u32>> =
            (0..self.triangles).map(|_| u32::try_from(i32::from_le_bytes(word())).ok()).collect();
        let mut piece = Piece {
            object: u32::try_from(self.object).ok(),
            triangles: Vec::with_capacity(self.triangles),
            materials: Vec::with_capacity(self.triangles),
            positions: Vec::new(),
        };
        for (corners, material) in corners.into_iter().zip(materials) {
            let [a, b, c] = corners.map(|corner| positions.get(corner as usize).copied());
            let (Some(a), Some(b), Some(c)) = (a, b, c) else {
                return Err(RendererError::Answer("a triangle has a vertex that does not exist".to_owned()));
            };
            let area = (b - a).cross(c - a).length_squared();
            if area > 0.0 && area.is_finite() {
                piece.triangles.push(corners);
                piece.materials.push(material);
            }
        }
        // No triangle that is left uses these.
        positions.iter_mut().filter(|place| !place.is_finite()).for_each(|place| *place = Vec3::ZERO);
        piece.positions = positions;
        Ok(piece)
    }
}

/// A material that is drawn.
fn opaque() -> Material {
    Material {
        name: String::new(),
        surface: Surface::Lambert { albedo: Color::plain(Vec3::ONE) },
        emission: Color::plain(Vec3::ZERO),
        emits_both_sides: false,
        opacity: 1.0,
        mask: None,
    }
}
