//! Synthetic images with a known cost in every pixel: convex cells (objects) of very uneven size. Costs are
//! smooth falloff, times a shadow edge, times noise, times a rare tail for some materials.

#![allow(dead_code, reason = "every test file uses its own part of this module")]

use forelight_forecast::{Cost, Expansion, FrameDesign, Observation, Pick, ProfiledFrame, Stratum};
use forelight_random::Random;

/// A stream of uniform numbers in (0, 1).
pub struct Stream(Random);

impl Stream {
    pub fn new(seed: u64) -> Self {
        let mut stream =
            Stream(Random::new(seed.wrapping_mul(0xd134_2543_de82_ef95) ^ 0x5851_f42d_4c95_7f2d));
        stream.uniform();
        stream.uniform();
        stream
    }

    pub fn uniform(&mut self) -> f64 {
        self.0.open_uniform()
    }

    pub fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// What makes costs vary inside an object.
#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    pub side: u32,
    pub objects: usize,
    pub materials: u32,
    /// Range of the standard deviation of log noise, pixel by pixel.
    pub noise: (f64, f64),
    /// Strength of the smooth part: the cost changes by up to this factor across an object.
    pub falloff: f64,
    /// Cost factor on one side of a straight edge through each object.
    pub shadow: f64,
    /// Share of materials with a tail; there 1 to 5 % of the pixels cost 10 to 40 times as much.
    pub tailed: f64,
}

pub const LIGHT: Recipe = Recipe {
    side: 128,
    objects: 57,
    materials: 18,
    noise: (0.1, 0.8),
    falloff: 1.0,
    shadow: 1.0,
    tailed: 0.0,
};

pub const INTERIOR: Recipe = Recipe { noise: (0.05, 0.5), falloff: 2.5, shadow: 2.0, ..LIGHT };

pub const TAILED: Recipe = Recipe { tailed: 0.3, ..LIGHT };

pub struct Picture {
    pub strata: Vec<Stratum>,
    pub ids: Vec<u32>,
    pub counts: Vec<u32>,
    pub side: u32,
    pub costs: Vec<Cost>,
}

impl Picture {
    /// A picture whose objects stay where they are for a `scene` seed and whose noise depends on `seed`.
    pub fn new(recipe: Recipe, scene: u64, seed: u64, shift: f64) -> Self {
        let mut stream = Stream::new(scene);
        let n = recipe.objects;
        struct Object {
            x: f64,
            y: f64,
            pull: f64,
            mean: f64,
            noise: f64,
            angle: f64,
            moving: bool,
        }
        let materials: Vec<(f64, f64, f64)> = (0..recipe.materials)
            .map(|_| {
                let mean = 1000.0 * (0.7 * stream.normal()).exp();
                if stream.uniform() < recipe.tailed {
                    (mean, 0.01 + 0.04 * stream.uniform(), 10.0 + 30.0 * stream.uniform())
                } else {
                    (mean, 0.0, 1.0)
                }
            })
            .collect();
        let strata: Vec<Stratum> = (0..n)
            .map(|object| Stratum {
                object: object as u32,
                material: (stream.uniform() * f64::from(recipe.materials)) as u32,
                prior_cost: 1.0,
                apart: false,
            })
            .collect();
        let objects: Vec<Object> = strata
            .iter()
            .enumerate()
            .map(|(i, s)| Object {
                x: stream.uniform(),
                y: stream.uniform(),
                // Zipf-like sizes: a few walls, many small things.
                pull: 0.25 / (1.0 + i as f64).sqrt(),
                mean: materials[s.material as usize].0 * (0.3 * stream.normal()).exp(),
                noise: recipe.noise.0 + (recipe.noise.1 - recipe.noise.0) * stream.uniform(),
                angle: std::f64::consts::TAU * stream.uniform(),
                moving: i % 5 == 4,
            })
            .collect();
        let mut noise = Stream::new(seed ^ 0xabcd_ef01);
        let side = recipe.side;
        let mut ids = Vec::new();
        let mut costs = Vec::new();
        for pixel in 0..side * side {
            let x = f64::from(pixel % side) / f64::from(side);
            let y = f64::from(pixel / side) / f64::from(side);
            let distance = |o: &Object| {
                let ox = if o.moving { (o.x + shift).fract() } else { o.x };
                ((x - ox).powi(2) + (y - o.y).powi(2)).sqrt() - o.pull
            };
            let nearest =
                (0..n).min_by(|&a, &b| distance(&objects[a]).total_cmp(&distance(&objects[b]))).unwrap_or(0);
            let o = &objects[nearest];
            let (dx, dy) = (x - o.x, y - o.y);
            let smooth = recipe.falloff.powf(2.0 * dx);
            let edge = if dx * o.angle.cos() + dy * o.angle.sin() > 0.02 { recipe.shadow } else { 1.0 };
            let (_, share, factor) = materials[strata[nearest].material as usize];
            let tail = if noise.uniform() < share { factor } else { 1.0 };
            let work = o.mean * smooth * edge * tail * (o.noise * noise.normal()).exp();
            ids.push(nearest as u32);
            costs.push(cost_of(work));
        }
        let mut counts = vec![0; n];
        ids.iter().for_each(|&id| counts[id as usize] += 1);
        Picture { strata, ids, counts, side, costs }
    }

    pub fn truth(&self) -> f64 {
        self.costs.iter().map(|c| c.work).sum::<u64>() as f64
    }

    pub fn observe(&self, picks: &[Pick]) -> Vec<Observation> {
        picks.iter().map(|p| Observation { stratum: p.stratum, cost: self.costs[p.pixel as usize] }).collect()
    }

    /// Both phases.
    pub fn profile(&self, samples: u32, seed: u64, frame: i64) -> (Vec<Pick>, Vec<Observation>) {
        let design =
            FrameDesign::new(&self.strata, &self.ids, self.side, samples, seed, frame).expect("a good image");
        let mut picks = design.first_phase();
        let first = self.observe(&picks);
        picks.extend(design.second_phase(&first).expect("observations of this design"));
        let observations = self.observe(&picks);
        (picks, observations)
    }
}

/// A profiled frame without costs beside its pixels.
pub fn profile_of(frame: usize, observations: &[Observation]) -> ProfiledFrame<'_> {
    let (fixed, build) = (Cost::default(), Cost::default());
    ProfiledFrame { frame, observations, expansion: &Expansion::Groups, fixed, build }
}

/// A cost whose columns all follow the work.
pub fn cost_of(work: f64) -> Cost {
    let work = work.round().max(1.0) as u64;
    Cost { work, cpu_nanos: work * 3, rays: [1, work / 100, 0, work / 500, 0, work / 50, 0] }
}

/// Relative errors of many trials, summed up.
#[derive(Debug)]
pub struct Errors {
    pub bias: f64,
    pub mean_absolute: f64,
    pub root_mean_square: f64,
    /// Standard error of `bias`.
    pub bias_error: f64,
}

pub fn errors(relative: &[f64]) -> Errors {
    let n = relative.len() as f64;
    let bias = relative.iter().sum::<f64>() / n;
    let square = relative.iter().map(|e| e * e).sum::<f64>() / n;
    Errors {
        bias,
        mean_absolute: relative.iter().map(|e| e.abs()).sum::<f64>() / n,
        root_mean_square: square.sqrt(),
        bias_error: ((square - bias * bias) / n).sqrt(),
    }
}
