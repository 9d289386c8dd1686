//! Area lights of a scene with few of them. Every point samples each luminaire, uniformly by area.

use super::{LightPoint, Surface, cumulative, is_near, part};
use crate::Reach;
use crate::bounds::Bounds;
use forelight_scene::Frame;
use glam::{Vec2, Vec3};

/// All emitting triangles of one (object, material) pair, sampled as one light.
#[derive(Debug, Clone)]
pub struct Luminaire {
    /// The (object, material) pair, which selects random numbers independent of other luminaires.
    pub stratum: u32,
    /// Total area, m².
    pub area: f32,
    /// Bounding box.
    pub bounds: Bounds,
    surfaces: Vec<Surface>,
    /// Cumulative share of the area by triangle. The last entry is 1.
    cumulative: Vec<f32>,
}

/// The area lights of a frame.
#[derive(Debug, Clone, Default)]
pub struct Luminaires {
    /// First the luminaires that can light something visible, then the others.
    pub all: Vec<Luminaire>,
    reaching: usize,
    /// Luminaire of each stratum. `u32::MAX` if the stratum does not emit.
    of_stratum: Vec<u32>,
}

impl Luminaires {
    /// Collects emitting triangles with an area. Luminaires that light nothing visible only if `complete`.
    pub fn new(frame: &Frame, reach: &Reach, complete: bool) -> Self {
        let geometry = &frame.geometry;
        let mut members: Vec<Vec<(u32, f64)>> = vec![Vec::new(); geometry.strata.len()];
        let emits = |s: u32| {
            let material = geometry.strata.pairs[s as usize].1 as usize;
            frame.materials[material].is_emissive() && (complete || reach.area_light(s))
        };
        for (t, &stratum) in geometry.triangle_stratum.iter().enumerate() {
            if emits(stratum) {
                let [a, b, c] = geometry.corners(t as u32).map(|p| p.as_dvec3());
                let area = (b - a).cross(c - a).length() * 0.5;
                if area > 0.0 && area.is_finite() {
                    members[stratum as usize].push((t as u32, area));
                }
            }
        }
        let mut luminaires = Self { of_stratum: vec![u32::MAX; members.len()], ..Self::default() };
        let found = |reaches: bool| {
            let strata = (0..).zip(&members).filter(|(_, members)| !members.is_empty());
            strata.filter(move |(stratum, _)| reach.area_light(*stratum) == reaches)
        };
        luminaires.reaching = found(true).count();
        for (stratum, members) in found(true).chain(found(false)) {
            let areas = members.iter().map(|m| m.1);
            let corners = members.iter().flat_map(|m| geometry.corners(m.0));
            luminaires.of_stratum[stratum as usize] = luminaires.all.len() as u32;
            luminaires.all.push(Luminaire {
                stratum,
                bounds: Bounds::of(corners),
                area: areas.clone().sum::<f64>() as f32,
                cumulative: cumulative(areas).collect(),
                surfaces: members.iter().map(|m| Surface::of(geometry, m.0)).collect(),
            });
        }
        luminaires
    }

    /// Number of luminaires that can light something visible.
    pub fn reaching(&self) -> usize {
        self.reaching
    }

    /// The luminaire of a stratum.
    pub fn of_stratum(&self, stratum: u32) -> Option<usize> {
        let index = *self.of_stratum.get(stratum as usize)?;
        (index != u32::MAX).then_some(index as usize)
    }

    /// Density per steradian of a uniform point on a luminaire. The light leaves at an angle of cosine `cos`
    /// (> 0) and travels the squared distance `distance2` (m²).
    pub fn density(&self, index: usize, distance2: f32, cos: f32) -> f32 {
        distance2 / (cos * self.all[index].area)
    }
}

impl Luminaire {
    /// See [`is_near`].
    pub fn is_near(&self, point: Vec3) -> bool {
        is_near(&self.bounds, self.area, point)
    }

    /// A uniform point on the luminaire.
    pub fn sample(&self, u: Vec2) -> LightPoint {
        let (i, within) = part(&self.cumulative, u.x);
        self.surfaces[i].point(Vec2::new(within, u.y))
    }
}
