//! Lights with a position, one by one: emitting triangles and lights without surface.

use super::LightPoint;
use super::bounds::Bounds;
use super::tree::{LightTree, Receiver};
use crate::Reach;
use forelight_scene::{Color, Frame, Material, Texels};
use glam::{Vec2, Vec3};

/// A light with a position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Emitter {
    /// An emitting triangle, by its place among [`Emitters`].
    Triangle(usize),
    /// A light without surface, by its index in the frame.
    Point(usize),
}

/// All of them, and the tree by which one is chosen.
#[derive(Debug, Clone, Default)]
pub struct Emitters {
    /// Emitting triangles in ascending order, with their areas in m².
    triangles: Vec<(u32, f32)>,
    /// Lights without surface that shine, in ascending order; in the tree they come after the triangles.
    points: Vec<u32>,
    tree: LightTree,
}

impl Emitters {
    /// Collects what shines: triangles that have an area and emit, that are not entirely transparent, and points with an intensity.
    /// What cannot matter to the picture is not among them.
    pub fn new(frame: &Frame, materials: &[Material], reach: &Reach) -> Self {
        let geometry = &frame.geometry;
        let mut glow = Glow::new(frame, materials);
        let (mut triangles, mut points, mut bounds) = (Vec::new(), Vec::new(), Vec::new());
        for (t, &stratum) in geometry.triangle_stratum.iter().enumerate() {
            let (t, material) = (t as u32, geometry.strata.pairs[stratum as usize].1 as usize);
            if !glow.may_shine(material) || !reach.area_light(stratum) {
                continue;
            }
            let (normal, area) = plane(geometry.corners(t));
            let intensity = f64::from(glow.radiance(t, material)) * f64::from(area);
            if area >= f32::MIN_POSITIVE && area.is_finite() && intensity > 0.0 && intensity.is_finite() {
                let both = materials[material].emits_both_sides;
                triangles.push((t, area));
                bounds.push(Bounds::flat(geometry.corners(t), normal, area, both, intensity));
            }
        }
        for (i, light) in frame.points.iter().enumerate() {
            let intensity = f64::from(light.intensity.max_element());
            if intensity > 0.0 && light.intensity.is_finite() && reach.point_light(i) {
                points.push(i as u32);
                let cone = light.cone.map(|(axis, _, outer)| (axis, outer));
                bounds.push(Bounds::point(light.position, cone, intensity));
            }
        }
        Self { triangles, points, tree: LightTree::new(&bounds) }
    }

    /// Irradiance that all of them together are expected to bring, W/m².
    pub fn importance(&self, receiver: &Receiver) -> f64 {
        self.tree.importance(receiver)
    }

    /// One of them, see [`LightTree::choose`].
    pub fn choose(&self, receiver: &Receiver, u: f64, visited: &mut u64) -> Option<(Emitter, f64)> {
        let (index, probability) = self.tree.choose(receiver, u, visited)?;
        let emitter = match self.points.get(index.wrapping_sub(self.triangles.len())) {
            Some(&point) => Emitter::Point(point as usize),
            None => Emitter::Triangle(index),
        };
        Some((emitter, probability))
    }

    /// Probability with which [`Self::choose`] chooses an emitting triangle.
    pub fn probability(&self, receiver: &Receiver, emitter: usize, visited: &mut u64) -> f64 {
        self.tree.probability(receiver, emitter, visited)
    }

    /// The place of one of the frame's triangles among the emitters.
    pub fn of_triangle(&self, triangle: u32) -> Option<usize> {
        self.triangles.binary_search_by_key(&triangle, |t| t.0).ok()
    }

    /// Density per steradian of a uniform point of an emitting triangle that was chosen with this probability (or so often), for
    /// light that leaves it under `cos` (> 0) at a squared distance of `distance2` m².
    pub fn density(&self, emitter: usize, probability: f64, distance2: f32, cos: f32) -> f32 {
        let area = f64::from(self.triangles[emitter].1);
        (probability * f64::from(distance2) / (f64::from(cos) * area)) as f32
    }

    /// A uniform point of an emitting triangle.
    pub fn point(&self, frame: &Frame, emitter: usize, u: Vec2) -> LightPoint {
        LightPoint::on(frame, self.triangles[emitter].0, u)
    }

    /// Whether a point is closer to the box of an emitting triangle than the triangle is wide. There, points chosen by area miss
    /// the few that matter (their weight grows like 1/distance²), and directions chosen by the surface have to help.
    pub fn is_near(&self, frame: &Frame, emitter: usize, point: Vec3) -> bool {
        let (triangle, area) = self.triangles[emitter];
        let [a, b, c] = frame.geometry.corners(triangle);
        is_near(a.min(b).min(c), a.max(b).max(c), area, point)
    }

    /// Whether a point is near any emitting triangle.
    pub fn any_near(&self, frame: &Frame, point: Vec3) -> bool {
        let may_hold = |bounds: &Bounds| is_near(bounds.low, bounds.high, bounds.largest_area, point);
        self.tree.any(may_hold, |i| i < self.triangles.len() && self.is_near(frame, i, point))
    }
}

fn is_near(low: Vec3, high: Vec3, area: f32, point: Vec3) -> bool {
    let outside = (low - point).max(point - high).max(Vec3::ZERO);
    outside.length_squared() < area
}

/// Unit normal and area of a triangle, in f64 because corners lie far from the origin and close to each other.
fn plane([a, b, c]: [Vec3; 3]) -> (Vec3, f32) {
    let cross = (b - a).as_dvec3().cross((c - a).as_dvec3());
    (cross.normalize_or_zero().as_vec3(), (0.5 * cross.length()) as f32)
}

/// How bright triangles are.
struct Glow<'a> {
    frame: &'a Frame,
    materials: &'a [Material],
    /// The largest value in each texture that varies an emission, once it is known.
    brightest: Vec<Option<f32>>,
}

/// A textured triangle counts as at least this share as bright as its brightest texel could make it: where the texture was
/// looked at it may be darker than elsewhere.
const FLOOR: f32 = 1.0 / 64.0;

/// Barycentric weights at which a triangle's texture is looked at: the centres of a subdivision into 16.
const LOOKS: u32 = 4;

impl<'a> Glow<'a> {
    fn new(frame: &'a Frame, materials: &'a [Material]) -> Self {
        Self { frame, materials, brightest: vec![None; frame.textures.len()] }
    }

    /// Whether a material can emit at all.
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

    /// Mean radiance of a triangle in the strongest channel, W/(m² sr), as far as a few looks at its texture tell.
    fn radiance(&mut self, triangle: u32, material: usize) -> f32 {
        let Material { emission, opacity, .. } = self.materials[material];
        let Some(texture) = emission.texture else { return opacity * emission.factor.max_element() };
        let image = &self.frame.textures[texture.0 as usize];
        let mut sum = 0.0;
        for i in 0..LOOKS {
            for j in 0..LOOKS {
                // Upright and upside-down subtriangles of the grid, told apart by the sum of the coordinates.
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
