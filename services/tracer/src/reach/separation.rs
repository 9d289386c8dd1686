//! Finds what shells hide from the camera.

use super::facet::Facet;
use super::shell::{Shell, shells};
use super::tree::Tree;
use super::wall::{Meeting, Wall};
use super::weld::{Groups, Sets, number, weld};
use crate::bounds::Bounds;
use forelight_scene::{Frame, Geometry, Material, Surface};
use glam::Vec3;

/// Shells with more triangles than this are not examined, because that would take noticeable time.
const LARGEST_SHELL: usize = 1 << 18;

/// Triangle visits allowed per triangle of the scene. The last of too many shells are not examined.
const VISITS: usize = 16;

/// A shading normal that deviates more than this from the geometric one (in radians) lets rays leave through
/// the surface. Sampled directions are at least 2⁻¹² away from the plane.
const FLAT: f32 = 1.0 / 16_384.0;

/// Why something is hidden from the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kept {
    /// Object id of the shell.
    pub shell: u32,
    /// `true`: the shell contains the camera. `false`: it contains what is hidden.
    pub holds_camera: bool,
}

/// Everything that cannot be seen, after any number of bounces.
pub struct Separation {
    /// Connected piece of each triangle, and the result for each piece.
    piece: Vec<u32>,
    pieces: Vec<Option<Kept>>,
    /// The result for each point light.
    pub points: Vec<Option<Kept>>,
    /// The result for everything at infinity: suns and environment.
    pub sky: Option<Kept>,
}

impl Separation {
    pub fn new(frame: &Frame, materials: &[Material]) -> Self {
        let geometry = &*frame.geometry;
        let vertex = weld(&geometry.positions);
        let corners: Vec<[u32; 3]> =
            geometry.triangles.iter().map(|t| t.map(|v| vertex[v as usize])).collect();
        let mut sets = Sets::new(vertex.len());
        for &[a, b, c] in &corners {
            sets.join(a, b);
            sets.join(a, c);
        }
        let of_vertex = sets.representatives();
        let mut used = vec![false; vertex.len()];
        for c in &corners {
            used[of_vertex[c[0] as usize] as usize] = true;
        }
        let (pieces, count) = number(&of_vertex, |v| used[v]);
        let piece = corners.iter().map(|c| pieces[of_vertex[c[0] as usize] as usize].unwrap_or_default());
        let piece = piece.collect();
        let found =
            Self { piece, pieces: vec![None; count], points: vec![None; frame.points.len()], sky: None };
        let opaque: Vec<bool> = materials.iter().map(is_opaque).collect();
        let search = Search::new(frame, &opaque, found);
        let shells = shells(geometry, &corners, &search.around_something());
        search.run(shells)
    }

    pub fn of_triangle(&self, triangle: u32) -> Option<Kept> {
        self.pieces[self.piece[triangle as usize] as usize]
    }

    /// Returns `true` if any triangle is hidden from the camera.
    pub fn any(&self) -> bool {
        self.pieces.iter().any(Option::is_some)
    }
}

/// Returns `true` if no light passes a surface of this material at any point.
fn is_opaque(material: &Material) -> bool {
    let passes = matches!(material.surface, Surface::ThinGlass { .. } | Surface::Glass { .. });
    !passes && !material.is_cutout()
}

/// Returns `true` if the triangle is shaded by its geometric normal.
fn is_flat(geometry: &Geometry, triangle: u32) -> bool {
    let geometric = geometry.geometric_normal(triangle);
    let normals = geometry.triangles[triangle as usize].map(|v| geometry.normals[v as usize]);
    normals.contains(&Vec3::ZERO) || normals.iter().all(|n| n.cross(geometric).length() <= FLAT)
}

struct Search<'a> {
    frame: &'a Frame,
    /// For each material.
    opaque: &'a [bool],
    /// Triangles by piece, and the bounding boxes of the pieces.
    members: Groups,
    bounds: Vec<Bounds>,
    tree: Tree,
    /// Largest coordinate of anything that rays start from or end at.
    extent: f32,
    /// Number of triangles that may still be visited.
    budget: usize,
    found: Separation,
}

impl<'a> Search<'a> {
    fn new(frame: &'a Frame, opaque: &'a [bool], found: Separation) -> Self {
        let geometry = &frame.geometry;
        let members = Groups::new(found.pieces.len(), found.piece.iter().map(|&p| Some(p)));
        let bounds: Vec<Bounds> = (0..members.len() as u32)
            .map(|p| Bounds::of(members.get(p).iter().flat_map(|&t| geometry.corners(t))))
            .collect();
        let camera = frame.camera.origin.abs().max_element() + frame.camera.aperture_radius;
        let lights = frame.points.iter().map(|light| light.position.abs().max_element());
        let extent = bounds.iter().map(Bounds::reach).chain(lights).fold(camera, f32::max);
        let tree = Tree::new(bounds.iter().copied());
        let budget = VISITS * geometry.triangles.len() + 100_000;
        Self { frame, opaque, members, bounds, tree, extent, budget, found }
    }

    fn is_opaque(&self, triangle: u32) -> bool {
        self.opaque[self.frame.geometry.material(triangle) as usize]
    }

    /// Opaque triangles of the pieces that may contain something: a light, the camera, or another piece.
    fn around_something(&self) -> Vec<u32> {
        let lights = self.frame.points.iter().map(|light| light.position);
        let points: Vec<Vec3> = lights.chain([self.frame.camera.origin]).collect();
        let holds = |piece: u32| {
            let own = &self.bounds[piece as usize];
            points.iter().any(|&p| own.holds(&Bounds::of([p])))
                || self
                    .tree
                    .any_overlapping(own, |other| other != piece && own.holds(&self.bounds[other as usize]))
        };
        let holding: Vec<bool> = (0..self.bounds.len() as u32).map(holds).collect();
        let triangles = (0..self.found.piece.len() as u32)
            .filter(|&t| holding[self.found.piece[t as usize] as usize] && self.is_opaque(t));
        triangles.collect()
    }

    fn run(mut self, mut shells: Vec<Shell>) -> Separation {
        // Largest first: they hide most, and what they hide needs no second reason.
        let volume = |s: &Shell| (s.bounds.high - s.bounds.low).element_product();
        shells.sort_by(|a, b| volume(b).total_cmp(&volume(a)).then_with(|| a.triangles.cmp(&b.triangles)));
        for shell in &shells {
            self.look_at(shell);
        }
        self.found
    }

    fn spend(&mut self, visits: usize) -> bool {
        let affordable = visits <= self.budget;
        self.budget = self.budget.saturating_sub(visits);
        affordable
    }

    /// Finds what one shell hides from the camera, if the shell meets the conditions of the proof.
    fn look_at(&mut self, shell: &Shell) -> Option<()> {
        let (frame, geometry) = (self.frame, &*self.frame.geometry);
        let camera = &frame.camera;
        let own = self.found.piece[shell.triangles[0] as usize];
        let fits = |bounds: &Bounds| shell.bounds.holds(bounds);
        let unexplained = |p: u32| p != own && self.found.pieces[p as usize].is_none();
        let may_hold =
            self.tree.any_overlapping(&shell.bounds, |p| fits(&self.bounds[p as usize]) && unexplained(p))
                || frame.points.iter().any(|light| fits(&Bounds::of([light.position])));
        let may_hold_camera = fits(&Bounds::of([camera.origin]));
        let relied_on = (may_hold || may_hold_camera)
            && shell.triangles.len() <= LARGEST_SHELL
            && self.spend(4 * shell.triangles.len())
            && shell.triangles.iter().all(|&t| is_flat(geometry, t));
        if !relied_on {
            return None;
        }
        let wall = Wall::new(geometry, shell, self.extent);
        let origin = camera.origin.as_dvec3();
        if wall.is_near_point(origin, camera.aperture_radius) {
            return None;
        }
        let inside = wall.holds(origin)?;
        if !(may_hold || inside) || wall.leaks(inside) {
            return None;
        }
        let pieces = self.pieces_beyond(&wall, shell, inside)?;
        let kept = Kept { shell: object_of(geometry, shell), holds_camera: inside };
        for piece in pieces {
            self.found.pieces[piece as usize].get_or_insert(kept);
        }
        for (light, found) in frame.points.iter().zip(&mut self.found.points) {
            let position = light.position.as_dvec3();
            if !wall.is_near_point(position, 0.0) && wall.holds(position) == Some(!inside) {
                found.get_or_insert(kept);
            }
        }
        if inside {
            self.found.sky.get_or_insert(kept);
        }
        Some(())
    }

    /// The pieces wholly on the side of a shell without the camera. `None` if anything lets light past the
    /// shell, or the budget is exhausted.
    fn pieces_beyond(&mut self, wall: &Wall<'_>, shell: &Shell, inside: bool) -> Option<Vec<u32>> {
        let geometry = &*self.frame.geometry;
        let reach = wall.reach();
        let mut close = vec![false; self.members.len()];
        self.tree.any_overlapping(&reach, |p| {
            close[p as usize] = true;
            false
        });
        // Pieces that are not near the shell are outside.
        let mut beyond: Vec<u32> =
            (0..).zip(&close).filter(|(_, close)| inside && !**close).map(|p| p.0).collect();
        for piece in (0..).zip(&close).filter(|(_, close)| **close).map(|p| p.0) {
            if !self.spend(self.members.get(piece).len()) {
                return None;
            }
            let mut touches = false;
            // Pieces that do not touch the shell need not be examined triangle by triangle.
            let members = self.members.get(piece);
            let members = if wall.may_meet(&self.bounds[piece as usize]) { members } else { &[] };
            for &t in members {
                if shell.triangles.binary_search(&t).is_ok() {
                    touches = true;
                    continue;
                }
                if !reach.overlaps(&Bounds::of(geometry.corners(t))) {
                    continue;
                }
                let sealed = self.is_opaque(t) && is_flat(geometry, t);
                match wall.meets(&Facet::new(geometry, t), sealed, inside) {
                    Meeting::Apart => {}
                    Meeting::Touches => touches = true,
                    Meeting::Leaks => return None,
                }
            }
            let first = self.members.get(piece)[0];
            let corner = || geometry.corners(first)[0].as_dvec3();
            if !touches && wall.holds(corner()) == Some(!inside) {
                beyond.push(piece);
            }
        }
        Some(beyond)
    }
}

/// The object that most of a shell's triangles belong to. Ties go to the lowest id.
fn object_of(geometry: &Geometry, shell: &Shell) -> u32 {
    let mut objects: Vec<u32> = shell.triangles.iter().map(|&t| geometry.object(t)).collect();
    objects.sort_unstable();
    let runs = objects.chunk_by(|a, b| a == b);
    runs.rev().max_by_key(|run| run.len()).map_or(0, |run| run[0])
}
