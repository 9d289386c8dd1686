//! Reuse of records between frames.
//!
//! A record stays valid while the light that it gathered is the same. It is dropped if one of its 48 plan
//! rays hits something that moved, passes a place that something moved to, or hits a point whose light passes
//! something that moved. If lights or materials change, all records are dropped.

use super::plan::world;
use super::{Cache, Level, Planned};
use crate::bounds::Bounds;
use crate::tracer::Tracer;
use glam::Vec3;

/// Number of a cache's records that were kept and dropped for another frame, by level.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Shared {
    /// Records that are valid in the other frame.
    pub kept: Vec<u64>,
    /// Records that are not.
    pub dropped: Vec<u64>,
}

impl Cache {
    /// Whether the records are valid in the tracer's frame: same geometry, light and light settings.
    pub fn suits(&self, tracer: &Tracer) -> bool {
        self.fingerprint == tracer.cache_fingerprint()
    }

    /// The records of this cache that are valid in the frame of `to`. The cache must be planned for `from`.
    pub fn carried(&self, from: &Tracer, to: &Tracer) -> (Self, Shared) {
        let counts = |levels: &[Level]| levels.iter().map(|level| level.planned.len() as u64).collect();
        if self.suits(to) {
            let all: Vec<u64> = counts(&self.levels);
            let dropped = vec![0; all.len()];
            return (self.clone(), Shared { kept: all, dropped });
        }
        let mut carried = Self {
            fingerprint: to.cache_fingerprint(),
            origin: to.origin(),
            world: world(to),
            reading: self.reading,
            ..Self::default()
        };
        if let Some(change) = Change::between(from, to) {
            // Start with the deepest level: a record that reads a dropped one must be dropped too.
            let mut deeper: Option<(&Level, Vec<bool>)> = None;
            for level in self.levels.iter().rev() {
                let strata = &level.strata;
                let keeps = |planned: &Planned| {
                    let reads_dropped = deeper.as_ref().is_some_and(|(level, kept)| {
                        witnesses(strata, planned, from)
                            .any(|witness| witness.hit.is_some_and(|at| level.near_dropped(at, kept)))
                    });
                    !reads_dropped && !change.touches(strata, planned, from)
                };
                let kept: Vec<bool> = level.planned.iter().map(keeps).collect();
                carried.levels.insert(0, level.only(&kept, carried.world));
                deeper = Some((level, kept));
            }
        }
        let kept: Vec<u64> =
            if carried.levels.is_empty() { vec![0; self.levels.len()] } else { counts(&carried.levels) };
        let dropped = self.records().iter().zip(&kept).map(|(all, kept)| all - kept).collect();
        (carried, Shared { kept, dropped })
    }
}

impl Level {
    /// Returns `true` if a point may read a record that was dropped.
    fn near_dropped(&self, place: Vec3, kept: &[bool]) -> bool {
        self.index.at(place).any(|index| !kept[index as usize])
    }

    /// The level with some of its records. Smoothed values stay if all contributing records are kept.
    fn only(&self, kept: &[bool], world: Bounds) -> Self {
        let mut level = Self {
            strata: self.strata,
            accuracy: self.accuracy,
            smallest: self.smallest,
            largest: self.largest,
            is_first: self.is_first,
            brightness: self.brightness,
            secondary: self.secondary.carried(),
            ..Self::default()
        };
        let known = self.known_values();
        for index in (0..kept.len()).filter(|&index| kept[index]) {
            let planned = &self.planned[index];
            level.planned.push(planned.clone());
            level.records.push(self.records[index].clone());
            let all_kept = || self.neighbours(index).all(|(neighbour, _)| kept[neighbour as usize]);
            level.known.push(known[index].filter(|_| all_kept()));
        }
        level.explored = level.planned.len();
        level.prepare(world);
        level
    }
}

/// A plan ray.
struct Witness {
    origin: Vec3,
    direction: Vec3,
    length: f32,
    triangle: Option<u32>,
    hit: Option<Vec3>,
}

fn witnesses<'a>(
    strata: &'a super::Strata,
    planned: &'a Planned,
    tracer: &'a Tracer,
) -> impl Iterator<Item = Witness> + 'a {
    planned.hits.iter().zip(planned.directions(strata)).map(move |(hit, direction)| Witness {
        origin: planned.site.position,
        direction,
        length: hit.map_or(f32::INFINITY, |hit| hit.t),
        triangle: hit.map(|hit| hit.primitive),
        hit: hit.map(|hit| hit.position(tracer.frame.geometry.corners(hit.primitive))),
    })
}

/// What differs in another frame.
struct Change {
    /// For each object, whether it moved.
    moved: Vec<bool>,
    /// Bounding boxes of the moved objects, before and after.
    places: Vec<Bounds>,
    /// Bounding boxes of the lights.
    lights: Vec<Bounds>,
    suns: Vec<Vec3>,
    /// Whether the environment emits.
    sky: bool,
}

impl Change {
    /// `None` if no light can be shown to be the same.
    fn between(from: &Tracer, to: &Tracer) -> Option<Self> {
        let (old, new) = (&from.frame.geometry, &to.frame.geometry);
        let same_light = from.frame.points == to.frame.points
            && from.frame.suns == to.frame.suns
            && from.frame.environment == to.frame.environment
            && from.frame.materials == to.frame.materials
            && from.settings.cache == to.settings.cache;
        let same_parts = old.triangles == new.triangles
            && old.triangle_stratum == new.triangle_stratum
            && old.uvs == new.uvs
            && old.strata == new.strata;
        if !(same_light && same_parts) {
            return None;
        }
        let objects = old.strata.objects.len();
        let mut moved = vec![false; objects];
        let mut places = vec![Bounds::EMPTY; objects];
        for (triangle, corners) in old.triangles.iter().enumerate() {
            if corners.iter().any(|&v| {
                old.positions[v as usize] != new.positions[v as usize]
                    || old.normals[v as usize] != new.normals[v as usize]
            }) {
                let object = old.object(triangle as u32) as usize;
                moved[object] = true;
                for &v in corners {
                    let both = Bounds::of([old.positions[v as usize], new.positions[v as usize]]);
                    places[object] = places[object].union(both);
                }
            }
        }
        let luminaires = &from.luminaires;
        let emits = |object: usize| {
            let strata = old.strata.pairs.iter().enumerate();
            strata.clone().any(|(stratum, pair)| {
                pair.0 as usize == object && luminaires.of_stratum(stratum as u32).is_some()
            })
        };
        if (0..objects).any(|object| moved[object] && emits(object)) {
            return None;
        }
        let area = luminaires.all.iter().map(|luminaire| luminaire.bounds);
        let points = from.frame.points.iter().map(|light| Bounds::of([light.position]));
        Some(Self {
            places: places
                .into_iter()
                .zip(&moved)
                .filter(|(_, moved)| **moved)
                .map(|(bounds, _)| bounds)
                .collect(),
            moved,
            lights: area.chain(points).collect(),
            suns: from.frame.suns.iter().map(|sun| sun.direction).collect(),
            sky: !from.sky.is_black(),
        })
    }

    fn touches(&self, strata: &super::Strata, planned: &Planned, from: &Tracer) -> bool {
        let geometry = &from.frame.geometry;
        let here = planned.site.position;
        // The record is on or near something that moved.
        self.places.iter().any(|place| place.contains(here))
            || witnesses(strata, planned, from).any(|witness| {
                witness.triangle.is_some_and(|triangle| self.moved[geometry.object(triangle) as usize])
                    || self
                        .places
                        .iter()
                        .any(|place| place.meets(witness.origin, witness.direction, witness.length))
                    || witness.hit.is_some_and(|at| self.shadows(at))
            })
    }

    /// Returns `true` if something that moved may be between a point and a light.
    fn shadows(&self, point: Vec3) -> bool {
        self.places.iter().any(|place| {
            // Near everything that moved, another part of the sky is visible.
            let by_sky = self.sky && place.grown_by(place.half()).contains(point);
            by_sky
                || self.suns.iter().any(|&sun| place.meets(point, sun, f32::INFINITY))
                || self.lights.iter().any(|light| {
                    let towards = light.low + light.half() - point;
                    place.grown_by(light.half()).meets(point, towards, 1.0)
                })
        })
    }
}
