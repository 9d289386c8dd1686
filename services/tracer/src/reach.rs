//! Finds lights and objects that cannot affect the image.
//!
//! An object cannot affect it if no light path from the camera can meet it. A light cannot affect it if it
//! reaches nothing that is visible. Such lights and objects are left out, and the image stays the same.
//!
//! # Shells
//!
//! A *shell* is a set of opaque triangles in which every edge belongs to an even number of triangles. Corners
//! at exactly equal positions count as one. *Opaque* means that no light passes: no glass, no cut-out. A
//! shell has no border modulo 2, so it has an inside: the points from which a ray in general direction
//! crosses the shell an odd number of times.
//!
//! **Lemma.** A light path that starts on one side of a shell never meets anything on the other side.
//!
//! *Proof.* A segment from one side to the other crosses the shell at least once. The triangle test is
//! watertight, because edges are decided by sign in the same way for all triangles that share them. So the
//! segment hits the shell at or before the crossing. The hit is opaque, so the path continues from there with
//! a new ray, on the side from which it came. By induction, the path stays on its side. ∎
//!
//! Everything wholly inside a shell that does not contain the camera is invisible and lights nothing visible.
//! So is everything wholly outside a shell that contains the camera, including suns and environment. A
//! connected piece of geometry is *wholly* on one side under two conditions. One of its corners is there:
//! three rays in f64 agree, and none is close to an edge. None of its triangles comes within a margin of the
//! shell. Every shell is examined separately.
//!
//! The proof assumes that a path stays "on the side from which it came". But rays start slightly off the
//! surface, along the geometric normal, and their directions are chosen about the shading normal. So a shell
//! is only used if:
//! * It is shaded by its geometric normals. With an interpolated normal, a ray could leave through it.
//! * It does not meet itself at an acute angle on the camera's side, where that offset would lead across it.
//! * Touching triangles are perpendicular to it, or opaque and flush with it. A glass on the floor of a room,
//!   or a stool with splayed legs, therefore invalidates the room.
//! * The camera's lens is farther from it than the margin.
//!
//! What remains is rounding in f32: a ray that leaves a point within an ulp of a seam may start beyond a
//! wall. Leaving out what is beyond does not make such a light leak worse.
//!
//! # Lights
//!
//! A light is also left out if it emits nothing or has no area, if everything else is behind all of its
//! one-sided triangles, or if its cone contains nothing.
//!
//! When in doubt, nothing is left out. In usual scenes, the time is about n log n in the size of the scene,
//! except for shells that may contain something; these have a budget.

mod facet;
mod separation;
mod shell;
mod tree;
mod wall;
mod weld;

use crate::bounds::Bounds;
use forelight_scene::{Color, Environment, Frame, Geometry, Material, PointLight, Surface};
use glam::{DVec3, Vec3};
use separation::{Kept, Separation};
use std::fmt;
use tree::Tree;

/// What can affect the image of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Reach {
    /// For each triangle, whether a path from the camera may meet it. Empty if all may be met.
    seen: Vec<bool>,
    /// For each stratum, whether its emission, if any, may reach something visible.
    area_lights: Vec<bool>,
    points: Vec<bool>,
    suns: Vec<bool>,
    environment: bool,
    left_out: Vec<LeftOut>,
}

/// A light or object that cannot affect the image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeftOut {
    /// The light or object.
    pub what: Excluded,
    /// Why it cannot affect the image.
    pub reason: Reason,
}

/// A light or a part of the geometry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Excluded {
    /// The emissive triangles of one object and one material.
    AreaLight {
        /// Stratum id.
        stratum: u32,
        /// The object's name.
        object: String,
    },
    /// A point light, by its index in the frame.
    PointLight(usize),
    /// A distant light, by its index in the frame.
    Sun(usize),
    /// The environment.
    Environment,
    /// An object, or a part of it.
    Object {
        /// The object's name.
        object: String,
        /// Number of triangles that are left out.
        triangles: usize,
    },
}

/// Why something cannot affect the image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reason {
    /// Its intensity, radiance or texture is black.
    EmitsNothing,
    /// All of its triangles have zero area.
    NoArea,
    /// Everything else is behind its emitting side.
    FacesAway,
    /// There is nothing in the spot light's cone.
    EmptyCone,
    /// It is enclosed by opaque surfaces of this object, and the camera is outside.
    EnclosedIn(String),
    /// It is outside a closed room that contains the camera. This object's surfaces are the room's walls.
    OutsideRoom(String),
}

/// Finds what can affect the image of a frame; the module's documentation has the proof. `materials` are
/// those that the frame is rendered with, by the frame's material indices.
pub fn reachable(frame: &Frame, materials: &[Material]) -> Reach {
    Survey { frame, materials, separation: Separation::new(frame, materials) }.reach()
}

impl Reach {
    /// Everything can affect the image.
    pub fn everything(frame: &Frame) -> Self {
        Self {
            seen: Vec::new(),
            area_lights: vec![true; frame.geometry.strata.len()],
            points: vec![true; frame.points.len()],
            suns: vec![true; frame.suns.len()],
            environment: true,
            left_out: Vec::new(),
        }
    }

    /// Returns `true` if any triangle can be left out.
    pub fn hides_triangles(&self) -> bool {
        !self.seen.is_empty()
    }

    /// Returns `true` if a path from the camera may meet the triangle.
    pub fn triangle(&self, triangle: u32) -> bool {
        self.seen.get(triangle as usize).is_none_or(|&seen| seen)
    }

    /// Returns `true` if the emission of a stratum, if any, can affect the image.
    pub fn area_light(&self, stratum: u32) -> bool {
        self.area_lights[stratum as usize]
    }

    /// Returns `true` if a point light, given by its index in the frame, can affect the image.
    pub fn point_light(&self, index: usize) -> bool {
        self.points[index]
    }

    /// Returns `true` if a sun, given by its index in the frame, can affect the image.
    pub fn sun(&self, index: usize) -> bool {
        self.suns[index]
    }

    /// Returns `true` if the environment, if any, can affect the image.
    pub fn environment(&self) -> bool {
        self.environment
    }

    /// Which lights can affect the image, for comparing frames.
    pub(crate) fn lights(&self) -> impl fmt::Debug {
        (&self.area_lights, &self.points, &self.suns, self.environment)
    }

    /// The materials of the triangles that can affect the image, each once.
    pub(crate) fn materials<'a>(&self, geometry: &Geometry, materials: &'a [Material]) -> Vec<&'a Material> {
        let mut met = vec![false; materials.len()];
        for (t, &stratum) in (0..).zip(&geometry.triangle_stratum) {
            met[geometry.strata.pairs[stratum as usize].1 as usize] |= self.triangle(t);
        }
        materials.iter().zip(met).filter(|(_, met)| *met).map(|(material, _)| material).collect()
    }

    /// Everything that cannot affect the image: area lights, points, suns, environment, objects by id.
    pub fn left_out(&self) -> &[LeftOut] {
        &self.left_out
    }
}

/// The visible strata that have triangles, by their bounding boxes.
struct Visible {
    tree: Tree,
    /// Stratum and box of each item of the tree.
    strata: Vec<(u32, Bounds)>,
    /// Largest absolute coordinate.
    extent: f32,
}

impl Visible {
    /// From the boxes of all strata. Those of strata without visible triangles are empty.
    fn of(boxes: Vec<Bounds>) -> Self {
        let strata: Vec<_> = (0..).zip(boxes).filter(|(_, b)| b.low.x <= b.high.x).collect();
        let extent = strata.iter().fold(0.0f32, |extent, (_, bounds)| extent.max(bounds.reach()));
        Self { tree: Tree::new(strata.iter().map(|(_, bounds)| *bounds)), strata, extent }
    }

    /// Returns `true` if `found` returns `true` for any of the strata whose boxes `wanted` accepts. Where
    /// `wanted` refuses a box, nothing within it is asked for.
    fn any(&self, wanted: impl Fn(&Bounds) -> bool, found: impl Fn(u32, &Bounds) -> bool) -> bool {
        self.tree.any(wanted, |item| {
            let (stratum, bounds) = &self.strata[item as usize];
            found(*stratum, bounds)
        })
    }
}

/// The state of examining a frame.
struct Survey<'a> {
    frame: &'a Frame,
    materials: &'a [Material],
    separation: Separation,
}

impl Survey<'_> {
    fn reach(&self) -> Reach {
        let (frame, geometry) = (self.frame, &*self.frame.geometry);
        let mut reach = Reach::everything(frame);
        if self.separation.any() {
            let seen = |t| self.separation.of_triangle(t).is_none();
            reach.seen = (0..geometry.triangles.len() as u32).map(seen).collect();
        }
        // What is visible of each stratum, needed for cones and one-sided lights.
        let aimed = frame.points.iter().any(|light| light.cone.is_some());
        let emitters = self.emitters();
        let visible =
            Visible::of(if aimed || !emitters.is_empty() { self.boxes(&reach) } else { Vec::new() });
        let mut exclude = |mattered: &mut bool, what: Excluded, reason: Option<Reason>| {
            if let Some(reason) = reason {
                *mattered = false;
                reach.left_out.push(LeftOut { what, reason });
            }
        };
        for (stratum, triangles) in emitters {
            let object = name(geometry, geometry.strata.pairs[stratum as usize].0);
            let reason = self.area_light(stratum, &triangles, &visible);
            let what = Excluded::AreaLight { stratum, object };
            exclude(&mut reach.area_lights[stratum as usize], what, reason);
        }
        for (index, light) in frame.points.iter().enumerate() {
            let reason = self.point_light(index, light, &visible);
            exclude(&mut reach.points[index], Excluded::PointLight(index), reason);
        }
        let far = || self.separation.sky.map(|kept| self.reason(kept));
        for (index, sun) in frame.suns.iter().enumerate() {
            let reason = if sun.irradiance.max_element() <= 0.0 { Some(Reason::EmitsNothing) } else { far() };
            exclude(&mut reach.suns[index], Excluded::Sun(index), reason);
        }
        let reason = if self.is_black(&frame.environment) { Some(Reason::EmitsNothing) } else { far() };
        if frame.environment != Environment::Black {
            exclude(&mut reach.environment, Excluded::Environment, reason);
        }
        reach.left_out.extend(self.objects());
        reach
    }

    /// Emissive strata, with their triangles.
    fn emitters(&self) -> Vec<(u32, Vec<u32>)> {
        let geometry = &*self.frame.geometry;
        let emits = |s: u32| self.materials[geometry.strata.pairs[s as usize].1 as usize].is_emissive();
        let mut slots = vec![None; geometry.strata.len()];
        let mut emitters: Vec<(u32, Vec<u32>)> = Vec::new();
        for stratum in (0..geometry.strata.len() as u32).filter(|&s| emits(s)) {
            slots[stratum as usize] = Some(emitters.len());
            emitters.push((stratum, Vec::new()));
        }
        if !emitters.is_empty() {
            for (t, &stratum) in (0..).zip(&geometry.triangle_stratum) {
                if let Some(slot) = slots[stratum as usize] {
                    emitters[slot].1.push(t);
                }
            }
        }
        emitters.retain(|(_, triangles)| !triangles.is_empty());
        emitters
    }

    /// Bounding boxes of the visible triangles, by stratum.
    fn boxes(&self, reach: &Reach) -> Vec<Bounds> {
        let geometry = &*self.frame.geometry;
        let mut boxes = vec![Bounds::EMPTY; geometry.strata.len()];
        for (t, &stratum) in (0..).zip(&geometry.triangle_stratum) {
            if reach.triangle(t) {
                let known = &mut boxes[stratum as usize];
                *known = known.union(Bounds::of(geometry.corners(t)));
            }
        }
        boxes
    }

    fn area_light(&self, stratum: u32, triangles: &[u32], visible: &Visible) -> Option<Reason> {
        let geometry = &*self.frame.geometry;
        let material = &self.materials[geometry.strata.pairs[stratum as usize].1 as usize];
        if self.emits_black(&material.emission) {
            return Some(Reason::EmitsNothing);
        }
        let has_area = |&t: &u32| {
            let [a, b, c] = geometry.corners(t).map(|p| p.as_dvec3());
            let area = (b - a).cross(c - a).length();
            area > 0.0 && area.is_finite()
        };
        if !triangles.iter().any(has_area) {
            return Some(Reason::NoArea);
        }
        let kept: Option<Vec<Kept>> = triangles.iter().map(|&t| self.separation.of_triangle(t)).collect();
        if let Some(kept) = kept {
            return kept.first().map(|&kept| self.reason(kept));
        }
        let away = !material.emits_both_sides && self.faces_away(stratum, triangles, visible);
        away.then_some(Reason::FacesAway)
    }

    /// Whether camera and everything else visible are behind the planes of all triangles of a light.
    fn faces_away(&self, stratum: u32, triangles: &[u32], visible: &Visible) -> bool {
        let (geometry, camera) = (&*self.frame.geometry, &self.frame.camera);
        // Anything not behind the plane by `least` may be lit, also the light itself unless black and flat.
        let black = match self.materials[geometry.strata.pairs[stratum as usize].1 as usize].surface {
            Surface::Lambert { albedo } => albedo.factor == Vec3::ZERO,
            _ => false,
        };
        let lens = Bounds::of([camera.origin]).grown(camera.aperture_radius);
        let extent = lens.reach().max(visible.extent);
        let (least, rounding) = (f64::from(extent) / 262_144.0, f64::from(extent) / 4_194_304.0);
        black
            && triangles.iter().all(|&t| {
                let [a, b, c] = geometry.corners(t).map(|p| p.as_dvec3());
                let normal = (b - a).cross(c - a).normalize_or_zero();
                let before =
                    |bounds: &Bounds, by: f64| bounds.corners().any(|p| normal.dot(p.as_dvec3() - a) > by);
                let lit = |s: u32, bounds: &Bounds| s != stratum || before(bounds, rounding);
                !before(&lens, -least) && !visible.any(|bounds| before(bounds, -least), lit)
            })
    }

    fn point_light(&self, index: usize, light: &PointLight, visible: &Visible) -> Option<Reason> {
        if light.intensity.max_element() <= 0.0 {
            return Some(Reason::EmitsNothing);
        }
        if let Some(kept) = self.separation.points[index] {
            return Some(self.reason(kept));
        }
        let (axis, _, outer) = light.cone?;
        let lit = |bounds: &Bounds| in_cone(bounds, light.position, axis, outer);
        (!visible.any(lit, |_, _| true)).then_some(Reason::EmptyCone)
    }

    /// Objects with triangles that are hidden from the camera, by object and shell.
    fn objects(&self) -> Vec<LeftOut> {
        let geometry = &*self.frame.geometry;
        let key = |kept: Kept| (kept.shell, kept.holds_camera);
        let mut hidden: Vec<(u32, Kept)> = (0..geometry.triangles.len() as u32)
            .filter_map(|t| self.separation.of_triangle(t).map(|kept| (geometry.object(t), kept)))
            .collect();
        hidden.sort_unstable_by_key(|&(object, kept)| (object, key(kept)));
        let left_out = |run: &[(u32, Kept)]| LeftOut {
            what: Excluded::Object { object: name(geometry, run[0].0), triangles: run.len() },
            reason: self.reason(run[0].1),
        };
        hidden.chunk_by(|a, b| a == b).map(left_out).collect()
    }

    fn reason(&self, kept: Kept) -> Reason {
        let shell = name(&self.frame.geometry, kept.shell);
        if kept.holds_camera { Reason::OutsideRoom(shell) } else { Reason::EnclosedIn(shell) }
    }

    /// Returns `true` if an emission is black everywhere.
    fn emits_black(&self, emission: &Color) -> bool {
        let texture = emission.texture.and_then(|t| self.frame.textures.get(t.0 as usize));
        texture.is_some_and(|image| {
            (0..image.width as usize * image.height as usize)
                .all(|texel| (emission.factor * image.texel_color(texel)).max_element() <= 0.0)
        })
    }

    fn is_black(&self, environment: &Environment) -> bool {
        match *environment {
            Environment::Black => true,
            Environment::Constant(radiance) => radiance.max_element() <= 0.0,
            Environment::Image { texture, scale, .. } => {
                self.emits_black(&Color { factor: Vec3::splat(scale), texture: Some(texture) })
            }
        }
    }
}

/// Whether part of a box may be in a cone, by its bounding sphere. `axis` is a unit vector; `outer` is the
/// cosine of the half-angle.
fn in_cone(bounds: &Bounds, apex: Vec3, axis: Vec3, outer: f32) -> bool {
    let (low, high) = (bounds.low.as_dvec3(), bounds.high.as_dvec3());
    let to: DVec3 = 0.5 * (low + high) - apex.as_dvec3();
    let (distance, radius) = (to.length(), 0.5 * (high - low).length());
    if distance <= radius {
        return true;
    }
    let between = libm::acos((to.dot(axis.as_dvec3()) / distance).clamp(-1.0, 1.0));
    // Widened by 0.001 rad, because the tracer computes the angle in f32.
    between - libm::asin(radius / distance) <= libm::acos(f64::from(outer).clamp(-1.0, 1.0)) + 1e-3
}

fn name(geometry: &Geometry, object: u32) -> String {
    geometry.strata.objects[object as usize].clone()
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.reason)
    }
}

impl fmt::Display for Excluded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AreaLight { object, .. } => write!(f, "light of {object}"),
            Self::PointLight(index) => write!(f, "point light {index}"),
            Self::Sun(index) => write!(f, "sun {index}"),
            Self::Environment => f.write_str("environment"),
            Self::Object { object, triangles: 1 } => write!(f, "{object} (1 triangle)"),
            Self::Object { object, triangles } => write!(f, "{object} ({triangles} triangles)"),
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EmitsNothing => f.write_str("emits nothing"),
            Self::NoArea => f.write_str("has no area"),
            Self::FacesAway => f.write_str("faces away from everything"),
            Self::EmptyCone => f.write_str("its cone holds nothing"),
            Self::EnclosedIn(shell) => write!(f, "enclosed in {shell}"),
            Self::OutsideRoom(shell) => write!(f, "outside the closed room {shell} that holds the camera"),
        }
    }
}
