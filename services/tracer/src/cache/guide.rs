//! Guide: gives more rays to the strata of a gather where the light is concentrated.
//!
//! A small bright spot, such as a wall that a spot lamp shines at, lies in few of a gather's strata. One
//! ray each finds it by chance, and the image shows blotches. The plan's rays of a record's neighbours tell
//! where the light comes from. The record's own rays are not asked: so the number of rays in a stratum does
//! not depend on what the gather finds, and the mean of the gather stays unbiased.

use super::hemisphere::{PLAN_RAYS, Strata};
use super::{Level, Planned};
use crate::geometry::Basis;
use glam::Vec3;
use std::f32::consts::PI;

/// Largest number of neighbours whose rays are used.
const NEIGHBOURS: usize = 40;

/// Neighbours are nearer than this multiple of the distance at which a record is used.
const REACH: f32 = 8.0;

/// Smallest cosine between the normals of neighbours.
const LEAST_COS: f32 = 0.3;

/// Fewer rays than this say too little.
const LEAST_RAYS: f32 = 4.0 * PLAN_RAYS as f32;

/// A ray is bright if its radiance is above this multiple of the mean. The others count as spread evenly.
const BRIGHT: f32 = 4.0;

/// Weight in a stratum of a bright ray in the stratum beside it.
const BESIDE: f32 = 0.1;

/// Standard error that a gather may have, as a fraction of the level's mean irradiance. Smoothing reduces
/// it to a few per cent.
const TOLERATED: f32 = 0.2;

/// Most rays of a stratum.
const MOST_OF_STRATUM: f32 = 256.0;

/// Most rays of a record, as a multiple of its strata.
const MOST_OF_RECORD: f32 = 4.0;

/// Where the light of a level's records comes from, by the plan's rays.
#[derive(Debug, Default, Clone)]
pub struct Guide {
    /// Standard error that a gather may have, mean over the channels, W/m².
    tolerance: f32,
    /// Bright rays, record by record.
    bright: Vec<Bright>,
    /// By record: where its bright rays end, and the others.
    records: Vec<(usize, Moments)>,
}

/// A bright ray.
#[derive(Debug, Clone, Copy)]
struct Bright {
    /// Its hit. Its direction if it left the scene.
    to: Vec3,
    leaves: bool,
    radiance: f32,
}

/// Weighted moments of radiances.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    weight: f32,
    sum: f32,
    squares: f32,
}

impl Moments {
    fn add(&mut self, weight: f32, radiance: f32) {
        self.weight += weight;
        self.sum += weight * radiance;
        self.squares += weight * radiance * radiance;
    }

    fn plus(self, other: Self) -> Self {
        Self {
            weight: self.weight + other.weight,
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
        }
    }

    fn times(self, factor: f32) -> Self {
        Self { weight: factor * self.weight, sum: factor * self.sum, squares: factor * self.squares }
    }

    fn deviation(self) -> f32 {
        let mean = self.sum / self.weight;
        (self.squares / self.weight - mean * mean).max(0.0).sqrt()
    }
}

/// The radiance of the brightest records counts as this multiple of the median of those that are not dark. A
/// record beside a lamp would otherwise make every other spot look dim.
const BRIGHTEST_RECORD: f64 = 16.0;

/// Mean radiance of the plan's rays. It is chosen once per level, so that records of later frames do not
/// change it.
pub fn mean_radiance(planned: &[Planned]) -> f32 {
    let of_record =
        |planned: &Planned| planned.lit.iter().map(|&lit| f64::from(lit)).sum::<f64>() / PLAN_RAYS as f64;
    let means: Vec<f64> = planned.iter().map(of_record).collect();
    let mut lit: Vec<f64> = means.iter().copied().filter(|&mean| mean > 0.0).collect();
    lit.sort_unstable_by(f64::total_cmp);
    let most = BRIGHTEST_RECORD * lit.get(lit.len() / 2).copied().unwrap_or_default();
    (means.iter().map(|mean| mean.min(most)).sum::<f64>() / means.len().max(1) as f64) as f32
}

impl Guide {
    /// The guide of a level. `mean`: mean radiance of its rays.
    pub fn new(planned: &[Planned], strata: &Strata, mean: f32) -> Self {
        let mut guide = Self { tolerance: TOLERATED * PI * mean, ..Self::default() };
        for planned in planned {
            let is_bright = |radiance: f32| radiance > BRIGHT * mean;
            let mut others = Moments::default();
            planned.lit.iter().filter(|&&lit| !is_bright(lit)).for_each(|&lit| others.add(1.0, lit));
            // Most records have no bright ray, and need no directions.
            if planned.lit.iter().any(|&lit| is_bright(lit)) {
                let rays = planned.directions(strata).zip(&*planned.hits).zip(&*planned.lit);
                let bright = rays.filter(|&(_, &radiance)| is_bright(radiance));
                guide.bright.extend(bright.map(|((direction, hit), &radiance)| {
                    let to = hit.map_or(direction, |hit| planned.site.position + hit.t * direction);
                    Bright { to, leaves: hit.is_none(), radiance }
                }));
            }
            guide.records.push((guide.bright.len(), others));
        }
        guide
    }

    /// Whether records are allotted rays by it: whether any light is bright.
    pub fn is_asked(&self) -> bool {
        !self.bright.is_empty()
    }

    /// The bright rays of a record.
    fn bright(&self, record: usize) -> &[Bright] {
        let start = record.checked_sub(1).map_or(0, |before| self.records[before].0);
        &self.bright[start..self.records[record].0]
    }
}

impl Level {
    /// Number of rays in each stratum of a record's gather. `None` if each has one.
    pub(super) fn rays_of(&self, index: usize) -> Option<Vec<u16>> {
        self.guide().is_asked().then(|| self.deviations(index)).flatten().and_then(|all| self.allotted(&all))
    }

    /// Standard deviation of the radiance within each stratum of a record, by the rays of its neighbours.
    /// `None` if these are few, or none is bright.
    fn deviations(&self, index: usize) -> Option<Vec<f32>> {
        let (site, guide) = (&self.planned[index].site, self.guide());
        let neighbours = self.guides(index);
        let bright: usize = neighbours.iter().map(|&other| guide.bright(other).len()).sum();
        let others = neighbours.iter().map(|&other| guide.records[other].1);
        let others = others.fold(Moments::default(), Moments::plus);
        if bright == 0 || others.weight + (bright as f32) < LEAST_RAYS {
            return None;
        }
        let strata = self.strata.len();
        let mut moments = vec![others.times(1.0 / strata as f32); strata];
        let basis = Basis::new(site.normal);
        for ray in neighbours.iter().flat_map(|&other| guide.bright(other)) {
            let seen = if ray.leaves { ray.to } else { (ray.to - site.position).normalize_or_zero() };
            if let Some(stratum) = self.strata.containing(basis.to_local(seen)) {
                moments[stratum].add(1.0, ray.radiance);
                self.strata.beside(stratum).for_each(|beside| moments[beside].add(BESIDE, ray.radiance));
            }
        }
        Some(moments.into_iter().map(Moments::deviation).collect())
    }

    /// The nearest neighbours of a record that face a similar way, in order of distance.
    fn guides(&self, index: usize) -> Vec<usize> {
        let here = &self.planned[index];
        let position = here.site.position;
        let mut near: Vec<(f32, u32)> = self
            .places()
            .within(here.radius * self.accuracy * REACH, position)
            .map(|other| (other, &self.planned[other as usize].site))
            .filter(|&(other, site)| other as usize != index && site.normal.dot(here.site.normal) > LEAST_COS)
            .map(|(other, site)| (site.position.distance_squared(position), other))
            .collect();
        let order = |a: &(f32, u32), b: &(f32, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if near.len() > NEIGHBOURS {
            near.select_nth_unstable_by(NEIGHBOURS, order);
            near.truncate(NEIGHBOURS);
        }
        near.sort_unstable_by(order);
        near.into_iter().map(|(_, other)| other as usize).collect()
    }

    /// The fewest rays by which the standard error is within the tolerance: in proportion to the deviations
    /// (Neyman 1934), at least one each.
    fn allotted(&self, deviations: &[f32]) -> Option<Vec<u16>> {
        const STEPS: u32 = 12;
        let allowed = (self.guide().tolerance * deviations.len() as f32 / PI).powi(2);
        let rays = |deviation: &f32, scale: f32| (deviation * scale).ceil().clamp(1.0, MOST_OF_STRATUM);
        let most = MOST_OF_RECORD * deviations.len() as f32;
        let suffices = |scale: f32| {
            let (number, variance) = deviations.iter().fold((0.0, 0.0), |(number, variance), deviation| {
                let rays = rays(deviation, scale);
                (number + rays, variance + deviation * deviation / rays)
            });
            variance <= allowed || number >= most
        };
        let sum: f32 = deviations.iter().sum();
        // The first suffices for the variance. With the second, there are at most `most` rays more than
        // strata.
        let (mut low, mut high) = (0.0, (sum / allowed).min(most / sum));
        if suffices(low) || !high.is_finite() {
            return None;
        }
        for _ in 0..STEPS {
            let middle = 0.5 * (low + high);
            if suffices(middle) { high = middle } else { low = middle }
        }
        Some(deviations.iter().map(|deviation| rays(deviation, high) as u16).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounds::Bounds;
    use crate::cache::Site;
    use forelight_bvh::Hit;

    /// Records on a floor, 0.1 m apart, under a grey dome of radiance 0.1 and a bright spot overhead at x =
    /// 1 m.
    fn level(spot: f32) -> Level {
        let mut level = Level {
            strata: Strata::for_rays(192),
            is_first: true,
            accuracy: 0.2,
            smallest: 0.01,
            largest: 1.0,
            ..Level::default()
        };
        for number in 0..100u64 {
            let place = Vec3::new((number % 10) as f32, (number / 10) as f32, 0.0) * 0.1;
            let mut planned =
                Planned { key: number, ..Planned::in_the_open(Site::bare(place, Vec3::Z), 1.0) };
            for (ray, direction) in planned.directions(&level.strata).enumerate() {
                let t = 2.0 / direction.z.max(0.1);
                let at = place + t * direction;
                let in_spot = (at - Vec3::new(1.0, 0.5, 2.0)).length() < 0.35;
                planned.lit[ray] = if in_spot { spot } else { 0.1 };
                planned.hits[ray] = Some(Hit { primitive: 0, u: 0.0, v: 0.0, t });
            }
            level.planned.push(planned);
        }
        prepare(&mut level);
        level
    }

    fn prepare(level: &mut Level) {
        level.brightness = mean_radiance(&level.planned);
        level.prepare(Bounds { low: Vec3::ZERO, high: Vec3::ONE });
    }

    #[test]
    fn the_strata_of_a_bright_spot_get_more_rays_and_the_others_one() {
        let level = level(100.0);
        let counts = level.rays_of(44).expect("the spot is bright");
        let spot = Vec3::new(1.0, 0.5, 2.0) - level.planned[44].site.position;
        let towards = level.strata.containing(spot.normalize()).expect("it is above");
        assert!(counts[towards] > 4, "{} rays to the spot", counts[towards]);
        let away = level.strata.containing(Vec3::new(-1.0, 0.2, 1.0).normalize()).expect("it is above");
        assert_eq!(counts[away], 1);
        let all: u32 = counts.iter().map(|&count| u32::from(count)).sum();
        assert!((193..3 * 192).contains(&all), "{all} rays");
    }

    #[test]
    fn a_record_never_guides_itself() {
        let (mut level, before) = (level(100.0), level(100.0).rays_of(44));
        *level.planned[44].lit = [70.0; PLAN_RAYS];
        // The mean is kept, as for a plan that goes on.
        level.prepare(Bounds { low: Vec3::ZERO, high: Vec3::ONE });
        assert_eq!(level.rays_of(44), before);
        assert_ne!(level.rays_of(45), self::level(100.0).rays_of(45));
    }

    #[test]
    fn even_light_gets_one_ray_per_stratum() {
        assert_eq!(level(0.1).rays_of(44), None);
        assert_eq!(level(0.0).rays_of(44), None);
    }

    #[test]
    fn a_record_in_much_brighter_light_has_at_most_five_times_the_rays() {
        for bright in [1e3, 1e4, 1e9] {
            let mut level = level(0.1);
            // The neighbours of one record see very uneven light, and the level is dark.
            for number in [33, 34, 35, 43, 45, 53, 54, 55] {
                (0..PLAN_RAYS).for_each(|ray| level.planned[number].lit[ray] = bright * (ray % 3) as f32);
            }
            level.prepare(Bounds { low: Vec3::ZERO, high: Vec3::ONE });
            let counts = level.rays_of(44).expect("its neighbours see bright light");
            let all: u32 = counts.iter().map(|&count| u32::from(count)).sum();
            assert!(all > 192 && all <= 5 * 192, "{all} rays with {bright}");
        }
    }

    #[test]
    fn extreme_radiances_do_no_harm() {
        for spot in [1e-30, 1e12] {
            let mut level = level(spot);
            level.planned.iter_mut().for_each(|planned| {
                planned.lit.iter_mut().for_each(|lit| *lit = if *lit == spot { spot } else { 0.0 });
            });
            prepare(&mut level);
            for index in 0..100 {
                let counts = level.rays_of(index).unwrap_or_default();
                assert!(counts.iter().all(|&count| count >= 1), "{spot}");
                assert!(counts.iter().map(|&count| u32::from(count)).sum::<u32>() <= 5 * 192);
            }
        }
    }
}
