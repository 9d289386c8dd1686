//! What profiled pixels say of the image's error, stratum by stratum.
//!
//! The strata of cost serve for the error too, but for one thing: where a light, or the bright outside, borders on something else, a
//! pixel's samples are now the lamp and now the wall behind it. Such pixels are few, and may hold most of the error of an image of few
//! samples. The preview knows where they are; so they are a stratum of their own, of which some pixels are traced in addition.
//!
//! Errors have heavier tails than costs: one sample in ten thousand that meets a lamp by way of some rough steel may weigh more than
//! the rest of its stratum. So the blocks of neighbours that are traced for their time (see `warm_clock`) are asked too, four times as
//! many pixels for nothing. They lie close together and are likelier where the work is; within a stratum that hardly matters.

use crate::profile::forecast_strata;
use crate::renderer::{FrameRenderer, StratumInfo};
use forelight_forecast::accuracy::{NoiseCell, NoiseSample, PixelNoise, noise_cells};
use forelight_forecast::{ForecastError, Stratum};
use forelight_preview::{NOTHING, Preview};
use forelight_protocol::RenderSettings;
use std::collections::BTreeSet;

/// One pixel at the edge of a light for so many that are profiled.
const SAMPLES_PER_EDGE: usize = 4;

/// The profiled pixels of a frame with what their samples say.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameNoise {
    /// All pixels by stratum: one number for each of [`forecast_strata`], without the edges of lights, and these.
    pub counts: Vec<u32>,
    /// The profiled pixels.
    pub pixels: Vec<u32>,
    /// What their samples say, in the same order.
    pub samples: Vec<NoiseSample>,
    /// So many of them, the first ones, are scattered over the image; the others are blocks of neighbours.
    pub scattered: usize,
}

/// The strata of a frame's error.
pub fn noise_strata(strata: &[StratumInfo], settings: &RenderSettings) -> Vec<Stratum> {
    let mut all = forecast_strata(strata, settings);
    all.push(Stratum::edges_of_lights());
    all
}

impl FrameNoise {
    /// Cells of the frame, or of one of which `counts` pixels show each stratum.
    ///
    /// # Errors
    /// If the strata are not those of the frame.
    pub fn cells(&self, strata: &[Stratum], counts: &[u32]) -> Result<Vec<NoiseCell>, ForecastError> {
        noise_cells(strata, counts, &self.samples)
    }

    /// The pixels that are scattered over the image.
    pub fn scattered_pixels(&self) -> &[u32] {
        &self.pixels[..self.scattered]
    }

    /// At most so many of the scattered pixels, every so many-th, with what they said.
    #[must_use]
    pub fn thinned(&self, most: usize) -> Self {
        let count = most.min(self.scattered);
        // The middle of each of so many equal parts.
        let picks = (0..count).map(|i| (2 * i + 1) * self.scattered / (2 * count));
        let (pixels, samples) = picks.map(|i| (self.pixels[i], self.samples[i].clone())).unzip();
        Self { counts: self.counts.clone(), pixels, samples, scattered: count }
    }

    /// The scattered pixels alone, with what they said another time, in their order.
    #[must_use]
    pub fn with_scattered(&self, noise: impl IntoIterator<Item = PixelNoise>) -> Self {
        let samples = self.samples[..self.scattered].iter().zip(noise);
        let samples = samples.map(|(sample, noise)| NoiseSample { stratum: sample.stratum, noise });
        Self {
            counts: self.counts.clone(),
            pixels: self.scattered_pixels().to_vec(),
            samples: samples.collect(),
            scattered: self.scattered,
        }
    }

    /// Whether it says anything: not where the pixels were traced with a single camera sample.
    pub fn is_known(&self) -> bool {
        !self.samples.is_empty() && self.samples.iter().all(|sample| !sample.noise.drops.is_empty())
    }
}

/// Strata of a frame's pixels, with the edges of lights apart.
pub struct Zones {
    /// Stratum of every pixel: of [`noise_strata`].
    stratum: Vec<u32>,
    /// Pixels of each.
    pub counts: Vec<u32>,
}

impl Zones {
    /// Of a previewed frame. A pixel is at the edge of a light if it and the pixels around it do not all show the same, and one of
    /// them shows something that shines, or nothing.
    pub fn new(ready: &dyn FrameRenderer, preview: &Preview) -> Self {
        let materials = &ready.frame().materials;
        let shines: Vec<bool> =
            preview.pairs.iter().map(|&(_, material)| materials[material as usize].is_emissive()).collect();
        let background = preview.pairs.len() as u32;
        let edges = background + 1;
        let (width, height) = (preview.width, preview.height);
        let at = |x: u32, y: u32| preview.stratum[(y * width + x) as usize];
        let around = |i: u32, size: u32| i.saturating_sub(1)..(i + 2).min(size);
        let is_edge = |x: u32, y: u32| {
            let own = at(x, y);
            let near = || around(y, height).flat_map(|v| around(x, width).map(move |u| (u, v)));
            let bright = |stratum: u32| stratum == NOTHING || shines[stratum as usize];
            near().any(|(u, v)| at(u, v) != own) && near().any(|(u, v)| bright(at(u, v)))
        };
        let zone = |pixel: u32| match preview.stratum[pixel as usize] {
            _ if is_edge(pixel % width, pixel / width) => edges,
            NOTHING => background,
            stratum => stratum,
        };
        let stratum: Vec<u32> = (0..width * height).map(zone).collect();
        let mut counts = vec![0; edges as usize + 1];
        stratum.iter().for_each(|&stratum| counts[stratum as usize] += 1);
        Self { stratum, counts }
    }

    /// Pixels at the edges of lights that are to be traced in addition to `profiled` ones, evenly spread; none of `taken`.
    pub fn edges(&self, profiled: usize, taken: &BTreeSet<u32>) -> Vec<u32> {
        let edges = self.counts.len() as u32 - 1;
        let free: Vec<u32> = (0u32..)
            .zip(&self.stratum)
            .filter(|(p, s)| **s == edges && !taken.contains(p))
            .map(|p| p.0)
            .collect();
        let wanted = (profiled / SAMPLES_PER_EDGE).min(free.len());
        // The middle of each of so many equal parts.
        (0..wanted).map(|i| free[(2 * i + 1) * free.len() / (2 * wanted)]).collect()
    }

    /// The pixels that show one of these strata, ascending.
    pub fn pixels_of(&self, strata: &[usize]) -> Vec<u32> {
        let shown = (0u32..).zip(&self.stratum).filter(|(_, stratum)| strata.contains(&(**stratum as usize)));
        shown.map(|(pixel, _)| pixel).collect()
    }

    /// What pixels of this frame said.
    pub fn noise(&self, traced: impl IntoIterator<Item = (u32, PixelNoise)>, scattered: usize) -> FrameNoise {
        let (pixels, samples) = traced
            .into_iter()
            .map(|(pixel, noise)| (pixel, NoiseSample { stratum: self.stratum[pixel as usize], noise }))
            .unzip();
        FrameNoise { counts: self.counts.clone(), pixels, samples, scattered }
    }
}
