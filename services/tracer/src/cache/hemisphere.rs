//! The strata of a gather, and the integration of samples to irradiance and gradients.
//!
//! The hemisphere is divided into M rings and N sectors of equal cosine-weighted solid angle: sin²θ = (j + u)
//! / M, φ = 2π (k + v) / N. The plan has 4 × 12 strata. The fill divides each into s × s; the plan's ray is
//! one of them.

use crate::fresnel;
use crate::geometry::Basis;
use crate::random::Sampler;
use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Number of rings of the plan.
pub const RINGS: usize = 4;
/// Number of sectors of the plan.
pub const SECTORS: usize = 12;
/// Number of plan rays per record.
pub const PLAN_RAYS: usize = RINGS * SECTORS;

/// The sector, of 30°, that contains a direction in the tangent plane.
pub fn sector(x: f32, y: f32) -> usize {
    const TAN_30: f32 = 0.577_350_26;
    let (across, along) = (y.abs(), x.abs());
    let within = match () {
        () if across < along * TAN_30 => 0,
        () if across * TAN_30 < along => 1,
        () => 2,
    };
    match (x >= 0.0, y >= 0.0) {
        (true, true) => within,
        (false, true) => 5 - within,
        (false, false) => 6 + within,
        (true, false) => 11 - within,
    }
}

/// The strata of a fill. Each stratum of the plan is divided into `cut` × `cut`.
#[derive(Debug, Clone, Copy, Default)]
pub struct Strata {
    cut: usize,
    pub rings: usize,
    pub sectors: usize,
}

/// The result of one ray of a gather.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Radiance.
    pub radiance: Vec3,
    /// Distance to the ray's hit, metres. Infinite if the ray left the scene.
    pub distance: f32,
    /// Variance of the mean, mean over the channels; `None` for a single ray.
    pub variance: Option<f32>,
}

/// Mean of the rays of a stratum.
#[derive(Default)]
pub struct Mean {
    count: f32,
    radiance: Vec3,
    squares: f32,
    inverse: f32,
}

impl Mean {
    /// Adds a ray.
    pub fn add(&mut self, radiance: Vec3, distance: f32) {
        self.count += 1.0;
        self.radiance += radiance;
        self.squares += (radiance.element_sum() / 3.0).powi(2);
        self.inverse += 1.0 / distance;
    }

    /// The mean.
    pub fn sample(&self) -> Sample {
        let radiance = self.radiance / self.count;
        let mean = radiance.element_sum() / 3.0;
        let variance = (self.count > 1.0)
            .then(|| (self.squares / self.count - mean * mean).max(0.0) / (self.count - 1.0));
        let distance = self.count / self.inverse;
        Sample { radiance, distance, variance }
    }
}

/// Irradiance with its gradients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Irradiance {
    /// Irradiance per channel, W/m².
    pub value: Vec3,
    /// Standard error of the irradiance, mean over the channels, W/m².
    pub noise: f32,
    /// Rotational gradient by channel; see [`super::Record::rotation`].
    pub rotation: [Vec3; 3],
    /// Translational gradient by channel; see [`super::Record::translation`].
    pub translation: [Vec3; 3],
}

impl Strata {
    /// The strata for approximately this number of rays, at least the plan's.
    pub fn for_rays(rays: u32) -> Self {
        let cut = ((rays as f32 / PLAN_RAYS as f32).sqrt().round() as usize).max(1);
        Self { cut, rings: RINGS * cut, sectors: SECTORS * cut }
    }

    /// Number of strata.
    pub fn len(&self) -> usize {
        self.rings * self.sectors
    }

    /// The stratum (ring-major index) that contains the plan's ray `index`.
    pub fn of_plan(&self, index: usize) -> usize {
        let inner = |i: usize| i * self.cut + self.cut / 2;
        inner(index / SECTORS) * self.sectors + inner(index % SECTORS)
    }

    /// The plan's ray in a stratum, if it contains one.
    pub fn plan_ray(&self, stratum: usize) -> Option<usize> {
        let (j, k) = (stratum / self.sectors, stratum % self.sectors);
        let middle = |i: usize| i % self.cut == self.cut / 2;
        (middle(j) && middle(k)).then(|| j / self.cut * SECTORS + k / self.cut)
    }

    /// The direction of a stratum's ray, about +z. Further rays of a stratum are spread by a lattice (Roberts
    /// 2018) with a random shift.
    pub fn direction(&self, stratum: usize, ray: u16, sampler: &Sampler) -> Vec3 {
        const STEP: Vec2 = Vec2::new(0.754_877_7, 0.569_840_3);
        let (j, k) = (stratum / self.sectors, stratum % self.sectors);
        let jitter = (sampler.independent(stratum as u32) + f32::from(ray) * STEP).fract();
        let sin2 = (j as f32 + jitter.x) / self.rings as f32;
        let azimuth = self.azimuth(k as f32 + jitter.y);
        (azimuth * sin2.sqrt()).extend((1.0 - sin2).max(0.0).sqrt())
    }

    /// The stratum that contains a unit direction about +z; `None` below the horizon.
    pub fn containing(&self, local: Vec3) -> Option<usize> {
        if local.z <= 0.0 {
            return None;
        }
        let ring = ((1.0 - local.z * local.z).max(0.0) * self.rings as f32) as usize;
        let angle = libm::atan2f(local.y, local.x);
        let turn = if angle < 0.0 { angle + TAU } else { angle };
        let sector = (turn * (self.sectors as f32 / TAU)) as usize;
        Some(ring.min(self.rings - 1) * self.sectors + sector.min(self.sectors - 1))
    }

    /// The strata beside a stratum.
    pub fn beside(&self, stratum: usize) -> impl Iterator<Item = usize> {
        let (j, k) = (stratum / self.sectors, stratum % self.sectors);
        let sectors = self.sectors;
        let around = [1, sectors - 1].map(|step| j * sectors + (k + step) % sectors);
        let outer = (j + 1 < self.rings).then_some(stratum + sectors);
        let inner = stratum.checked_sub(sectors);
        around.into_iter().chain(outer).chain(inner)
    }

    fn azimuth(&self, k: f32) -> Vec2 {
        let (sin, cos) = libm::sincosf(TAU * k / self.sectors as f32);
        Vec2::new(cos, sin)
    }

    /// Weights of a ring's radiance under a coat with transmittance `passes` at a cosine. For the irradiance
    /// it is the mean over the ring. For the rotational gradient it is the mean of d(cos θ · passes) / d cos
    /// θ · tan θ. Taking tan θ at the centre of the ring, as published implementations do, makes the
    /// outermost weight 30 % too small.
    fn ring(&self, j: usize, passes: impl Fn(f32) -> f32) -> (f32, f32) {
        const STEPS: usize = 8;
        let cos = |step: usize| {
            let sin2 = (j as f32 + step as f32 / STEPS as f32) / self.rings as f32;
            (1.0 - sin2).max(0.0).sqrt()
        };
        let (mut passed, mut turned) = (0.0, 0.0);
        for step in 0..STEPS {
            let (inner, outer) = (cos(step), cos(step + 1));
            let middle = 0.5 * (inner + outer);
            passed += passes(middle) / STEPS as f32;
            // Integrate over steps of equal d(sin²θ) = −2 cos θ d(cos θ).
            let change = inner * passes(inner) - outer * passes(outer);
            turned += change * 2.0 * (1.0 - middle * middle).sqrt() * self.rings as f32;
        }
        (passed, turned)
    }

    /// Standard error of the sum over all strata, mean over the channels, from the spread within blocks of 2
    /// × 2 strata. Rather too large (collapsed strata: Cochran, *Sampling Techniques*, 3rd edition 1977,
    /// section 5A.12).
    fn noise(&self, samples: &[Sample]) -> f32 {
        let at = |j: usize, k: usize| samples[j * self.sectors + k];
        let mut variance = 0.0;
        // The numbers of rings and sectors are even.
        for j in (0..self.rings).step_by(2) {
            for k in (0..self.sectors).step_by(2) {
                let block = [at(j, k), at(j, k + 1), at(j + 1, k), at(j + 1, k + 1)];
                variance += block.iter().filter_map(|sample| sample.variance).sum::<f32>();
                let value = |sample: &Sample| sample.radiance.element_sum() / 3.0;
                let is_single = |sample: &&Sample| sample.variance.is_none();
                // One alone is compared with the whole block.
                let singles = block.iter().filter(is_single).count();
                let is_compared = |sample: &&Sample| singles == 1 || is_single(sample);
                let count = if singles == 1 { 4.0 } else { singles as f32 };
                let mean = block.iter().filter(is_compared).map(value).sum::<f32>() / count;
                let squares = block.iter().filter(is_single).map(|s| (value(s) - mean) * (value(s) - mean));
                variance += squares.sum::<f32>() * count / (count - 1.0);
            }
        }
        variance.sqrt()
    }

    /// Irradiance with gradients, under a coat of index `coat` (0 for none). Rotational gradient: Ward and
    /// Heckbert 1992. Translational: Křivánek et al. 2005 (equation 5), with the coat's transmittance at the
    /// borders of the strata.
    pub fn integrate(&self, samples: &[Sample], basis: &Basis, coat: f32) -> Irradiance {
        let (rings, sectors) = (self.rings as f32, self.sectors as f32);
        let passes =
            |cos: f32| if coat > 0.0 { 1.0 - fresnel::dielectric(cos, coat).reflectance } else { 1.0 };
        let at = |j: usize, k: usize| samples[j * self.sectors + k];
        let mut value = Vec3::ZERO;
        let mut rotation = [Vec3::ZERO; 3];
        let mut translation = [Vec3::ZERO; 3];
        let add = |gradient: &mut [Vec3; 3], direction: Vec3, amount: Vec3| {
            for channel in 0..3 {
                gradient[channel] += direction * amount[channel];
            }
        };
        let counted: Vec<(f32, f32)> = (0..self.rings).map(|j| self.ring(j, passes)).collect();
        for k in 0..self.sectors {
            let centre = self.azimuth(k as f32 + 0.5);
            let border = self.azimuth(k as f32);
            let (mut around, mut outward, mut sideways) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
            for (j, &(passed, turned)) in counted.iter().enumerate() {
                let sample = at(j, k);
                let sin2 = (j as f32 + 0.5) / rings;
                let (sin, cos) = (sin2.sqrt(), (1.0 - sin2).sqrt());
                let inner_sin2 = j as f32 / rings;
                let inner_cos = (1.0 - inner_sin2).sqrt();
                let outer_cos = (1.0 - (j + 1) as f32 / rings).max(0.0).sqrt();
                value += sample.radiance * passed;
                around += sample.radiance * turned;
                if j > 0 {
                    let inner = at(j - 1, k);
                    let share = inner_sin2.sqrt() * inner_cos * inner_cos * passes(inner_cos)
                        / sample.distance.min(inner.distance);
                    outward += (sample.radiance - inner.radiance) * share;
                }
                let before = at(j, (k + self.sectors - 1) % self.sectors);
                let share = cos * (inner_cos - outer_cos) * passes(cos)
                    / (sin * sample.distance.min(before.distance));
                sideways += (sample.radiance - before.radiance) * share;
            }
            add(&mut rotation, Vec3::new(-centre.y, centre.x, 0.0), around);
            add(&mut translation, centre.extend(0.0), outward * (TAU / sectors));
            add(&mut translation, Vec3::new(-border.y, border.x, 0.0), sideways);
        }
        let solid = PI / (rings * sectors);
        Irradiance {
            value: value * solid,
            noise: self.noise(samples) * solid,
            rotation: rotation.map(|local| basis.to_world(local * solid)),
            translation: translation.map(|local| basis.to_world(local)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Radiance and distance along a ray, in closed form: a floor between a luminous wall and ceiling.
    fn surroundings(origin: Vec3, direction: Vec3) -> Sample {
        // A wall at x = 2 with radiance 3, and a ceiling at z = 1.5 whose radiance varies along y.
        let wall = if direction.x > 0.0 { (2.0 - origin.x) / direction.x } else { f32::INFINITY };
        let ceiling = if direction.z > 0.0 { (1.5 - origin.z) / direction.z } else { f32::INFINITY };
        let distance = wall.min(ceiling);
        if distance == f32::INFINITY {
            return Sample { radiance: Vec3::ZERO, distance, variance: None };
        }
        let hit = origin + distance * direction;
        let radiance = if wall < ceiling { 3.0 } else { 1.0 + 0.5 * libm::sinf(hit.y) };
        Sample { radiance: Vec3::new(radiance, 2.0 * radiance, 0.0), distance, variance: None }
    }

    fn gathered(origin: Vec3, normal: Vec3, coat: f32) -> Irradiance {
        let strata = Strata::for_rays(48 * 24 * 24);
        let basis = Basis::new(normal);
        let sampler = Sampler::keyed(1);
        let samples: Vec<Sample> = (0..strata.len())
            .map(|s| surroundings(origin, basis.to_world(strata.direction(s, 0, &sampler))))
            .collect();
        strata.integrate(&samples, &basis, coat)
    }

    #[test]
    fn gradients_agree_with_central_differences() {
        for coat in [0.0, 1.5] {
            let origin = Vec3::new(0.3, 0.2, 0.0);
            let here = gathered(origin, Vec3::Z, coat);
            let step = 0.03;
            for axis in [Vec3::X, Vec3::Y] {
                let ahead = gathered(origin + step * axis, Vec3::Z, coat).value;
                let behind = gathered(origin - step * axis, Vec3::Z, coat).value;
                let slope = (ahead - behind).x / (2.0 * step);
                let gradient = here.translation[0].dot(axis);
                assert!(
                    (gradient - slope).abs() < 0.03 * here.value.x,
                    "moving along {axis}: {gradient}, not {slope}"
                );
                let turned = |angle: f32| {
                    let normal = Vec3::Z * libm::cosf(angle) + axis * libm::sinf(angle);
                    gathered(origin, normal, coat).value.x
                };
                let slope = (turned(step) - turned(-step)) / (2.0 * step);
                // The normal turns towards the axis, that is, about Z × axis.
                let gradient = here.rotation[0].dot(Vec3::Z.cross(axis));
                assert!(
                    (gradient - slope).abs() < 0.03 * here.value.x,
                    "turning to {axis}: {gradient}, not {slope}"
                );
            }
            assert!((here.value.y - 2.0 * here.value.x).abs() < 1e-4 * here.value.y && here.value.z == 0.0);
        }
    }

    #[test]
    fn the_noise_is_what_gathers_by_other_rays_differ_by() {
        let (strata, basis) = (Strata::for_rays(192), Basis::new(Vec3::Z));
        let gathers: Vec<Irradiance> = (0..400)
            .map(|key| {
                let sampler = Sampler::keyed(key);
                let direction = |stratum| strata.direction(stratum, 0, &sampler);
                let samples: Vec<Sample> =
                    (0..strata.len()).map(|s| surroundings(Vec3::new(1.5, 0.2, 0.0), direction(s))).collect();
                strata.integrate(&samples, &basis, 0.0)
            })
            .collect();
        let values = || gathers.iter().map(|gather| f64::from(gather.value.element_sum()) / 3.0);
        let count = gathers.len() as f64;
        let mean = values().sum::<f64>() / count;
        let true_noise = (values().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
        let noise = gathers.iter().map(|gather| f64::from(gather.noise)).sum::<f64>() / count;
        // Collapsed strata count some of the real differences between strata as noise.
        assert!((1.0..2.5).contains(&(noise / true_noise)), "{noise}, truly {true_noise}");
    }

    #[test]
    fn constant_surroundings_have_no_gradients() {
        let strata = Strata::for_rays(192);
        let sample = |i: usize| Sample { radiance: Vec3::ONE, distance: 0.5 + i as f32, variance: None };
        let samples: Vec<Sample> = (0..strata.len()).map(sample).collect();
        let sums = strata.integrate(&samples, &Basis::new(Vec3::Y), 0.0);
        assert!((sums.value - PI).abs().max_element() < 1e-4 && sums.noise < 1e-4);
        for gradient in sums.rotation.iter().chain(&sums.translation) {
            assert!(gradient.length() < 1e-4, "{gradient}");
        }
    }

    #[test]
    fn every_plan_ray_is_one_stratum_of_the_fill() {
        for rays in [48, 192, 432, 768, 1200] {
            let strata = Strata::for_rays(rays);
            assert_eq!(strata.len(), rays as usize);
            let found: Vec<usize> = (0..strata.len()).filter_map(|s| strata.plan_ray(s)).collect();
            assert_eq!(found, (0..PLAN_RAYS).collect::<Vec<_>>());
            for ray in 0..PLAN_RAYS {
                assert_eq!(strata.plan_ray(strata.of_plan(ray)), Some(ray));
            }
        }
    }

    #[test]
    fn a_direction_is_found_in_its_stratum_and_strata_beside_it_are_neighbours() {
        let strata = Strata::for_rays(192);
        for key in 0..20 {
            let sampler = Sampler::keyed(key);
            for stratum in 0..strata.len() {
                // Directions on a border may fall on either side.
                let found =
                    strata.containing(strata.direction(stratum, key as u16, &sampler)).expect("above");
                assert!(found == stratum || strata.beside(stratum).any(|beside| beside == found));
                assert!(
                    strata.beside(stratum).all(|beside| strata.beside(beside).any(|back| back == stratum))
                );
            }
        }
        assert_eq!(strata.containing(Vec3::NEG_Z), None);
    }

    #[test]
    fn sectors_are_thirty_degrees_each() {
        for degrees in 0..360u32 {
            let angle = (degrees as f32 + 0.5).to_radians();
            assert_eq!(sector(libm::cosf(angle), libm::sinf(angle)), degrees as usize / 30, "{degrees}");
        }
    }
}
