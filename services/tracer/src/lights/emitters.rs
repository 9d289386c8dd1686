//! Lights with a position: emitting patches of surfaces, sampled uniformly by area, and point lights. A light
//! tree chooses one.

use super::bounds::{Bounds as LightBounds, Receiver};
use super::tree::{Choice, LightTree};
use super::{LightPoint, Surface, cumulative, is_near, part};
use crate::Reach;
use crate::bounds::Bounds;
use crate::geometry::Basis;
use forelight_scene::{Color, Frame, Geometry, Material, Texels};
use glam::{Vec2, Vec3};

/// A light with a position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Emitter {
    /// An emitting patch, by its index in [`Emitters`].
    Patch(usize),
    /// A point light, by its index in the frame.
    Point(usize),
}

/// Triangles sampled as one light: a flat, compact, evenly bright piece of an object, or one triangle.
#[derive(Debug, Clone, Copy)]
struct Patch {
    /// Range of its triangles in [`Emitters::surfaces`].
    first: u32,
    end: u32,
    /// Total area, m².
    area: f32,
    bounds: Bounds,
}

/// All emitters, and the tree that chooses among them.
#[derive(Debug, Clone, Default)]
pub struct Emitters {
    patches: Vec<Patch>,
    /// Triangles by patch, and their cumulative shares of the patch's area.
    surfaces: Vec<Surface>,
    cumulative: Vec<f32>,
    /// Emitting triangles, ascending, each with its patch.
    patch_of: Vec<(u32, u32)>,
    /// Emitting point lights, ascending. In the tree they come after the patches.
    points: Vec<u32>,
    tree: LightTree,
}

/// With at most this many emitters, one random number is fine enough to choose an emitter and a point on it.
const FEW: usize = 256;

impl Emitters {
    /// Collects all emitters that can affect the image: triangles with an area that emit and are not fully
    /// transparent, and points with an intensity.
    pub fn new(frame: &Frame, materials: &[Material], reach: &Reach) -> Self {
        let geometry = &frame.geometry;
        let mut glow = Glow::new(frame, materials);
        let mut members: Vec<Vec<Member>> = vec![Vec::new(); geometry.strata.len()];
        for (t, &stratum) in geometry.triangle_stratum.iter().enumerate() {
            let (t, material) = (t as u32, geometry.strata.pairs[stratum as usize].1 as usize);
            if !glow.may_shine(material) || !reach.area_light(stratum) {
                continue;
            }
            let (normal, area) = plane(geometry.corners(t));
            let intensity = f64::from(glow.radiance(t, material)) * f64::from(area);
            if area >= f32::MIN_POSITIVE && area.is_finite() && intensity > 0.0 && intensity.is_finite() {
                members[stratum as usize].push(Member { triangle: t, normal, area, intensity });
            }
        }
        let mut emitters = Self::default();
        let mut bounds = Vec::new();
        for (members, (_, material)) in members.iter().zip(&geometry.strata.pairs) {
            let material = &materials[*material as usize];
            let even = material.emission.texture.is_none();
            let whole = even && is_flat_and_compact(geometry, members);
            let size = if whole { members.len() } else { 1 };
            for patch in members.chunks(size.max(1)) {
                bounds.push(emitters.add(geometry, patch, material.emits_both_sides));
            }
        }
        emitters.patch_of.sort_unstable();
        for (i, light) in frame.points.iter().enumerate() {
            let intensity = f64::from(light.intensity.max_element());
            if intensity > 0.0 && light.intensity.is_finite() && reach.point_light(i) {
                emitters.points.push(i as u32);
                let cone = light.cone.map(|(axis, _, outer)| (axis, outer));
                bounds.push(LightBounds::point(light.position, cone, intensity));
            }
        }
        Self { tree: LightTree::new(&bounds), ..emitters }
    }

    fn add(&mut self, geometry: &Geometry, members: &[Member], both_sides: bool) -> LightBounds {
        let corners = members.iter().flat_map(|m| geometry.corners(m.triangle));
        let areas = members.iter().map(|m| f64::from(m.area));
        let first = self.surfaces.len() as u32;
        let patch = Patch {
            first,
            end: first + members.len() as u32,
            area: areas.clone().sum::<f64>() as f32,
            bounds: Bounds::of(corners),
        };
        self.patch_of.extend(members.iter().map(|m| (m.triangle, self.patches.len() as u32)));
        self.surfaces.extend(members.iter().map(|m| Surface::of(geometry, m.triangle)));
        self.cumulative.extend(cumulative(areas));
        self.patches.push(patch);
        let intensity = members.iter().map(|m| m.intensity).sum();
        LightBounds::flat(patch.bounds, members[0].normal, patch.area, both_sides, intensity)
    }

    /// Estimated irradiance from all emitters together, W/m².
    pub fn importance(&self, receiver: &Receiver) -> f64 {
        self.tree.importance(receiver)
    }

    /// Returns `true` if one random number can choose an emitter and a point on it.
    pub fn are_few(&self) -> bool {
        self.patches.len() + self.points.len() <= FEW
    }

    /// Chooses emitters; see [`LightTree::choose`].
    pub fn choose(&self, receiver: &Receiver, choices: &mut [Choice], visited: &mut u64) {
        self.tree.choose(receiver, choices, visited);
    }

    /// The chosen emitter. `None` if the choice found none.
    pub fn chosen(&self, choice: &Choice) -> Option<Emitter> {
        let emitter = match self.points.get(choice.light.wrapping_sub(self.patches.len())) {
            Some(&point) => Emitter::Point(point as usize),
            None => Emitter::Patch(choice.light),
        };
        (choice.probability > 0.0).then_some(emitter)
    }

    /// Probability with which [`Self::choose`] chooses a patch.
    pub fn probability(&self, receiver: &Receiver, patch: usize, visited: &mut u64) -> f64 {
        self.tree.probability(receiver, patch, visited)
    }

    /// The patch that contains one of the frame's triangles.
    pub fn of_triangle(&self, triangle: u32) -> Option<usize> {
        let found = self.patch_of.binary_search_by_key(&triangle, |entry| entry.0).ok()?;
        Some(self.patch_of[found].1 as usize)
    }

    /// Density per steradian of a uniform point on a patch chosen with `probability` (or an expected number
    /// of choices). The light leaves at an angle of cosine `cos` (> 0) and travels the squared distance
    /// `distance2` (m²).
    pub fn density(&self, patch: usize, probability: f64, distance2: f32, cos: f32) -> f32 {
        let area = f64::from(self.patches[patch].area);
        (probability * f64::from(distance2) / (f64::from(cos) * area)) as f32
    }

    /// A uniform point on a patch.
    pub fn point(&self, patch: usize, u: Vec2) -> LightPoint {
        let Patch { first, end, .. } = self.patches[patch];
        let (i, within) = part(&self.cumulative[first as usize..end as usize], u.x);
        self.surfaces[first as usize + i].point(Vec2::new(within, u.y))
    }

    /// See [`is_near`].
    pub fn is_near(&self, patch: usize, point: Vec3) -> bool {
        let Patch { area, bounds, .. } = self.patches[patch];
        is_near(&bounds, area, point)
    }

    /// Returns `true` if a point is near any patch.
    pub fn any_near(&self, point: Vec3) -> bool {
        let may_hold = |bounds: &LightBounds| is_near(&bounds.place(), bounds.largest_area, point);
        self.tree.any(may_hold, |i| i < self.patches.len() && self.is_near(i, point))
    }
}

/// An emitting triangle.
#[derive(Debug, Clone, Copy)]
struct Member {
    triangle: u32,
    normal: Vec3,
    area: f32,
    /// Radiant intensity along the normal, in the strongest channel, W/sr.
    intensity: f64,
}

/// Normals with at least this cosine count as one plane, well within the tolerance of [`LightBounds`].
const SAME_PLANE: f32 = 1.0 - 1.2e-7;

/// Smallest fraction of a rectangle that a compact patch covers. A disc covers 0.79.
const COMPACT: f64 = 0.6;

/// Whether triangles lie in one plane and fill most of a rectangle, aligned with the shortest edge of the
/// largest. Uniform sampling is then as good as preferring nearer triangles.
fn is_flat_and_compact(geometry: &Geometry, members: &[Member]) -> bool {
    let Some(largest) = members.iter().max_by(|a, b| a.area.total_cmp(&b.area)) else { return false };
    if members.iter().any(|m| m.normal.dot(largest.normal) < SAME_PLANE) {
        return false;
    }
    let [a, b, c] = geometry.corners(largest.triangle);
    let edges = [b - a, c - b, a - c];
    let shortest = edges.into_iter().min_by(|x, y| x.length_squared().total_cmp(&y.length_squared()));
    let along = shortest.unwrap_or(Vec3::X).normalize_or(Basis::new(largest.normal).to_world(Vec3::X));
    let extent = |axis: Vec3| {
        let places =
            || members.iter().flat_map(|m| geometry.corners(m.triangle)).map(|p| f64::from(p.dot(axis)));
        places().fold(f64::NEG_INFINITY, f64::max) - places().fold(f64::INFINITY, f64::min)
    };
    let across = largest.normal.cross(along);
    let area: f64 = members.iter().map(|m| f64::from(m.area)).sum();
    let (width, height, depth) = (extent(along), extent(across), extent(largest.normal));
    area >= COMPACT * width * height && depth * depth <= 1e-6 * area
}

/// Unit normal and area of a triangle, in f64: corners may be close together far from the origin.
fn plane([a, b, c]: [Vec3; 3]) -> (Vec3, f32) {
    let cross = (b - a).as_dvec3().cross((c - a).as_dvec3());
    (cross.normalize_or_zero().as_vec3(), (0.5 * cross.length()) as f32)
}

/// Computes the brightness of triangles.
struct Glow<'a> {
    frame: &'a Frame,
    materials: &'a [Material],
    /// The largest value in each texture that modulates an emission, once it is known.
    brightest: Vec<Option<f32>>,
}

/// Lower bound of a textured triangle's brightness relative to its brightest texel; samples may miss it.
const FLOOR: f32 = 1.0 / 64.0;

/// A triangle's texture is sampled at the centres of its subdivision into `LOOKS`² triangles.
const LOOKS: u32 = 4;

impl<'a> Glow<'a> {
    fn new(frame: &'a Frame, materials: &'a [Material]) -> Self {
        Self { frame, materials, brightest: vec![None; frame.textures.len()] }
    }

    /// Returns `true` if a material can emit at all.
    fn may_shine(&mut self, material: usize) -> bool {
        let Material { emission, opacity, .. } = self.materials[material];
        emission.factor.max_element() > 0.0
            && emission.factor.is_finite()
            && opacity > 0.0
            && self.brightest(&emission) > 0.0
    }

    fn brightest(&mut self, emission: &Color) -> f32 {
        let Some(texture) = emission.texture else { return 1.0 };
        let image = &self.frame.textures[texture.0 as usize];
        *self.brightest[texture.0 as usize].get_or_insert_with(|| {
            let texels = match &image.texels {
                Texels::Srgb8(texels) => texels.len(),
                Texels::Linear(texels) => texels.len(),
            };
            (0..texels).map(|i| image.texel_color(i).max_element()).fold(0.0, f32::max)
        })
    }

    /// Mean radiance of a triangle in the strongest channel, W/(m² sr), from a few texture samples.
    fn radiance(&mut self, triangle: u32, material: usize) -> f32 {
        let Material { emission, opacity, .. } = self.materials[material];
        let Some(texture) = emission.texture else { return opacity * emission.factor.max_element() };
        let image = &self.frame.textures[texture.0 as usize];
        let mut sum = 0.0;
        for i in 0..LOOKS {
            for j in 0..LOOKS {
                // The sum of coordinates tells upright from inverted subtriangles.
                let (b, c) = (i as f32 + 1.0 / 3.0, j as f32 + 1.0 / 3.0);
                let turned = i + j >= LOOKS;
                let (b, c) = if turned { (LOOKS as f32 - b, LOOKS as f32 - c) } else { (b, c) };
                let uv = self.frame.geometry.uv(triangle, b / LOOKS as f32, c / LOOKS as f32);
                sum += (emission.factor * image.color(uv)).max_element();
            }
        }
        let mean = sum / (LOOKS * LOOKS) as f32;
        let most = emission.factor.max_element() * self.brightest(&emission);
        opacity * mean.max(FLOOR * most)
    }
}
