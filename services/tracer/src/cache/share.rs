//! Records of one frame that hold in another.
//!
//! A record stays true as long as the light that it gathered does. Its 48 planned rays are taken as witnesses: it is dropped if
//! one of them meets something that moved, passes where something has moved to, or meets a point from which a light
//! is seen past something that moved. If lights or materials themselves change, every record is dropped.

use super::places::Places;
use super::plan::world;
use super::{Cache, Level, Planned};
use crate::bounds::Bounds;
use crate::geometry::Basis;
use crate::random::Sampler;
use crate::tracer::Tracer;
use glam::Vec3;

/// What became of a cache's records on the way to another frame, by level.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Shared {
    /// Records that hold in the other frame.
    pub kept: Vec<u64>,
    /// Records that do not.
    pub dropped: Vec<u64>,
}

impl Cache {
    /// The records of this cache, planned (and perhaps filled) for `from`, that hold in the frame of `to`.
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
            // The deepest level first: a record that reads one that was dropped cannot stay.
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
    /// Whether a place may be read from a record that was not kept.
    fn near_dropped(&self, place: Vec3, kept: &[bool]) -> bool {
        self.index.at(place).any(|index| !kept[index as usize])
    }

    /// The level with some of its records. What they say is known, unless one that is not kept had a part in it.
    fn only(&self, kept: &[bool], world: Bounds) -> Self {
        let mut level = Self {
            strata: self.strata,
            accuracy: self.accuracy,
            smallest: self.smallest,
            largest: self.largest,
            ..Self::default()
        };
        let known = self.known_values();
        let places = Places::of(&self.planned);
        for index in (0..kept.len()).filter(|&index| kept[index]) {
            let planned = &self.planned[index];
            level.planned.push(planned.clone());
            level.records.push(self.records[index].clone());
            let all_kept = || self.neighbours(index, &places).all(|(neighbour, _)| kept[neighbour as usize]);
            level.known.push(known[index].filter(|_| all_kept()));
        }
        level.explored = level.planned.len();
        level.index = level.indexed(world);
        level
    }
}

/// A planned ray.
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
    let basis = Basis::new(planned.site.normal);
    let sampler = Sampler::keyed(planned.key);
    planned.hits.iter().enumerate().map(move |(ray, hit)| Witness {
        origin: planned.site.position,
        direction: basis.to_world(strata.direction(strata.of_plan(ray), &sampler)),
        length: hit.map_or(f32::INFINITY, |hit| hit.t),
        triangle: hit.map(|hit| hit.primitive),
        hit: hit.map(|hit| hit.position(tracer.frame.geometry.corners(hit.primitive))),
    })
}

/// What is different in another frame.
struct Change {
    /// By object.
    moved: Vec<bool>,
    /// Where moved objects were and are.
    places: Vec<Bounds>,
    /// Where light comes from.
    lights: Vec<Bounds>,
    suns: Vec<Vec3>,
    /// Whether light comes from all around.
    sky: bool,
}

impl Change {
    /// `None` if nothing of the light can be said to be the same.
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
        // On or at something that moved.
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

    /// Whether something that moved may stand between a point and a light.
    fn shadows(&self, point: Vec3) -> bool {
        self.places.iter().any(|place| {
            // Around everything that moved, the sky is seen otherwise.
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
