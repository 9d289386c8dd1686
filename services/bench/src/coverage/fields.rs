//! Synthetic shots with light and heavy tails. Each has its own objects, materials, camera and costs.

use super::case::{Known, KnownFrame};
use forelight_forecast::{Cost, Stratum};
use forelight_random::Random;
use serde::Serialize;

/// Source of the variation inside an object, besides falloff of light and a shadow edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// Lognormal noise with a standard deviation of 0.1 to 0.5: a light tail.
    Light,
    /// Lognormal noise of 0.6 to 1.2.
    Lognormal,
    /// Pareto noise with an exponent of 1.6 to 3. Below 2 its variance is infinite.
    Pareto,
    /// In a third of the materials, 1 to 5 % of the pixels cost 10 to 40 times as much.
    RareStrata,
}

impl Family {
    pub const ALL: [Family; 4] = [Family::Light, Family::Lognormal, Family::Pareto, Family::RareStrata];

    /// Name in a table.
    pub const fn title(self) -> &'static str {
        match self {
            Family::Light => "synthetic: light tails",
            Family::Lognormal => "synthetic: lognormal tails",
            Family::Pareto => "synthetic: Pareto tails",
            Family::RareStrata => "synthetic: rare dear pixels",
        }
    }
}

/// Width and height of a picture in pixels, and number of frames.
const SIDE: u32 = 32;
const FRAMES: u32 = 8;

/// A stream of random numbers.
struct Stream(Random);

impl Stream {
    fn uniform(&mut self) -> f64 {
        self.0.open_uniform()
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn normal(&mut self) -> f64 {
        libm::sqrt(-2.0 * libm::log(self.uniform())) * libm::cos(std::f64::consts::TAU * self.uniform())
    }
}

struct Object {
    at: [f64; 2],
    speed: [f64; 2],
    pull: f64,
    mean: f64,
    /// Standard deviation of the noise, or exponent of its tail.
    noise: f64,
    /// Share and factor of expensive pixels.
    dear: (f64, f64),
    edge: [f64; 2],
    /// Oscillation of the light over time: amplitude and phase.
    light: (f64, f64),
}

/// The shot with this number. The same number gives the same shot.
pub fn shot(family: Family, number: u64) -> Known {
    let seed = number.wrapping_mul(0xd134_2543_de82_ef95) ^ 0x0005_f0a7_1e1d_0000;
    let mut stream = Stream(Random::new(seed));
    let materials: Vec<(f64, (f64, f64))> = (0..6)
        .map(|_| {
            let mean = 3000.0 * libm::exp(0.7 * stream.normal());
            let is_dear = stream.uniform() < 1.0 / 3.0 && family == Family::RareStrata;
            let dear = (stream.between(0.01, 0.05), stream.between(10.0, 40.0));
            (mean, if is_dear { dear } else { (0.0, 1.0) })
        })
        .collect();
    let count = 6 + (stream.uniform() * 14.0) as u32;
    let drift = [stream.between(-0.03, 0.03), stream.between(-0.02, 0.02)];
    let swing = stream.between(0.0, 0.4);
    let mut strata = Vec::with_capacity(count as usize);
    let objects: Vec<Object> = (0..count)
        .map(|object| {
            let material = (stream.uniform() * materials.len() as f64) as u32;
            strata.push(Stratum { object, material, prior_cost: 1.0, apart: false });
            let own = if object % 5 == 4 { 0.05 } else { 0.0 };
            let angle = std::f64::consts::TAU * stream.uniform();
            let (mean, dear) = materials[material as usize];
            Object {
                at: [stream.uniform(), stream.uniform()],
                speed: drift.map(|drift| drift + own * (stream.uniform() - 0.5)),
                pull: 0.3 / libm::sqrt(1.0 + f64::from(object)),
                mean: mean * libm::exp(0.3 * stream.normal()),
                noise: match family {
                    Family::Light | Family::RareStrata => stream.between(0.1, 0.5),
                    Family::Lognormal => stream.between(0.6, 1.2),
                    Family::Pareto => stream.between(1.6, 3.0),
                },
                dear,
                edge: [libm::cos(angle), libm::sin(angle)],
                light: (swing * stream.uniform(), std::f64::consts::TAU * stream.uniform()),
            }
        })
        .collect();
    let frames = (0..FRAMES).map(|t| frame(family, &objects, t, &mut stream)).collect();
    Known { strata, width: SIDE, frames }
}

fn frame(family: Family, objects: &[Object], t: u32, stream: &mut Stream) -> KnownFrame {
    let time = f64::from(t);
    let places: Vec<[f64; 2]> =
        objects.iter().map(|o| [0, 1].map(|axis| o.at[axis] + o.speed[axis] * time)).collect();
    let mut ids = Vec::with_capacity((SIDE * SIDE) as usize);
    let mut costs = Vec::with_capacity(ids.capacity());
    for pixel in 0..SIDE * SIDE {
        let at = [pixel % SIDE, pixel / SIDE].map(|place| f64::from(place) / f64::from(SIDE));
        let reach = |h: usize| libm::hypot(at[0] - places[h][0], at[1] - places[h][1]) - objects[h].pull;
        // There are at least six objects.
        let nearest = (1..objects.len()).fold(0, |best, h| if reach(h) < reach(best) { h } else { best });
        let object = &objects[nearest];
        let from = [at[0] - places[nearest][0], at[1] - places[nearest][1]];
        let shadow = if from[0] * object.edge[0] + from[1] * object.edge[1] > 0.02 { 2.0 } else { 1.0 };
        let light = 1.0 + object.light.0 * libm::sin(object.light.1 + 0.6 * time);
        let noise = match family {
            Family::Pareto => libm::pow(stream.uniform(), -1.0 / object.noise),
            _ => libm::exp(object.noise * stream.normal()),
        };
        let dear = if stream.uniform() < object.dear.0 { object.dear.1 } else { 1.0 };
        let work = object.mean * libm::exp(from[0]) * shadow * light * noise * dear;
        ids.push(nearest as u32);
        costs.push(Cost { work: (work as u64).max(1), ..Cost::default() });
    }
    KnownFrame { number: t.into(), ids, costs, fixed: Cost::default() }
}

#[cfg(test)]
mod tests {
    use super::{Family, shot};

    #[test]
    fn a_number_is_a_shot_and_another_number_another() {
        let works = |family, number| -> Vec<u64> {
            shot(family, number).frames.iter().flat_map(|f| f.costs.iter().map(|c| c.work)).collect()
        };
        for family in Family::ALL {
            assert_eq!(works(family, 3), works(family, 3));
            assert_ne!(works(family, 3), works(family, 4));
        }
        let heaviest = |family| {
            let all = works(family, 5);
            let mean = all.iter().sum::<u64>() as f64 / all.len() as f64;
            all.iter().max().copied().unwrap_or(0) as f64 / mean
        };
        assert!(heaviest(Family::Pareto) > 4.0 * heaviest(Family::Light));
    }
}
