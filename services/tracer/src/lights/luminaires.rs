//! Few area lights: each is sampled at every point, uniformly by area.

use super::{LightPoint, Surface, cumulative, is_near, part};
use crate::Reach;
use crate::bounds::Bounds;
use forelight_scene::Frame;
use glam::{Vec2, Vec3};

/// All emitting triangles of one (object, material): sampled as one light, uniformly by area.
#[derive(Debug, Clone)]
pub struct Luminaire {
    /// (object, material): by it the luminaire has random numbers of its own, whichever others there are.
    pub stratum: u32,
    /// Total area, m².
    pub area: f32,
    /// The box around it.
    pub bounds: Bounds,
    surfaces: Vec<Surface>,
    /// Cumulative share of the area by triangle; the last entry is 1.
    cumulative: Vec<f32>,
}

/// The area lights of a frame.
#[derive(Debug, Clone, Default)]
pub struct Luminaires {
    /// Those that may light something that is seen; then those that are put back nevertheless.
    pub all: Vec<Luminaire>,
    reaching: usize,
    /// Luminaire of each stratum, `u32::MAX` for those that do not emit.
    of_stratum: Vec<u32>,
}

impl Luminaires {
    /// Collects the emitting triangles. Those without area emit nothing; those that light nothing are left out, unless the collection
    /// is to be `complete`.
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

    /// How many of them may light something that is seen.
    pub fn reaching(&self) -> usize {
        self.reaching
    }

    /// The luminaire that a triangle's stratum belongs to.
    pub fn of_stratum(&self, stratum: u32) -> Option<usize> {
        let index = *self.of_stratum.get(stratum as usize)?;
        (index != u32::MAX).then_some(index as usize)
    }

    /// Density per steradian of a uniform point of a luminaire, for light that leaves it under `cos` (> 0) at a squared distance
    /// of `distance2` m².
    pub fn density(&self, index: usize, distance2: f32, cos: f32) -> f32 {
        distance2 / (cos * self.all[index].area)
    }
}

impl Luminaire {
    /// See [`is_near`].
    pub fn is_near(&self, point: Vec3) -> bool {
        is_near(&self.bounds, self.area, point)
    }

    /// A uniform point of the surface.
    pub fn sample(&self, u: Vec2) -> LightPoint {
        let (i, within) = part(&self.cumulative, u.x);
        self.surfaces[i].point(Vec2::new(within, u.y))
    }
}
