//! The image's error by stratum, from profiled and scanned pixels.
//!
//! The strata are those of cost, and one more: pixels where a light, or the bright outside, borders on
//! something else. They are few, and may hold most of the error of an image of few samples. The preview knows
//! where they are, so some more of them are traced.
//!
//! Errors have heavier tails than costs: one sample in ten thousand that meets a lamp via rough steel may
//! outweigh the rest of its stratum. So the blocks of neighbours that are traced for their time (see
//! `warm_clock`) are used too, which gives four times as many pixels. Still more pixels are scanned (see `scan`).

use crate::answers::StratumInfo;
use crate::frame::OwnFrame;
use crate::profile::strata::forecast_strata;
use forelight_forecast::accuracy::{NoiseCell, NoiseGroup, NoiseSample, PixelNoise, Sampled};
use forelight_forecast::{ForecastError, Stratum};
use forelight_preview::{NOTHING, Preview};
use forelight_protocol::RenderSettings;
use std::collections::BTreeSet;

/// Profiled pixels per pixel at the edge of a light.
const SAMPLES_PER_EDGE: usize = 4;

/// The profiled and scanned pixels of a frame, with their noise.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameNoise {
    /// All pixels by stratum of [`forecast_strata`], without edges of lights, and then these edges.
    pub counts: Vec<u32>,
    /// The profiled pixels.
    pub pixels: Vec<u32>,
    /// Their noise, in the same order.
    pub samples: Vec<NoiseSample>,
    /// The first pixels, this many, are scattered over the image. The others are blocks of neighbours.
    pub scattered: usize,
    /// Noise of the scanned pixels.
    pub scanned: Vec<NoiseSample>,
}

/// The strata of a frame's error.
pub fn noise_strata(strata: &[StratumInfo], settings: &RenderSettings) -> Vec<Stratum> {
    let mut all = forecast_strata(strata, settings);
    all.push(Stratum::edges_of_lights());
    all
}

impl FrameNoise {
    /// Noise cells of a frame of which `counts` pixels show each stratum.
    ///
    /// # Errors
    /// If the strata do not match the frame.
    pub fn cells(&self, strata: &[Stratum], counts: &[u32]) -> Result<Vec<NoiseCell>, ForecastError> {
        Ok(self.groups(strata, counts)?.into_iter().flat_map(|group| group.cells).collect())
    }

    /// The same by groups of strata.
    ///
    /// # Errors
    /// If the strata do not match the frame.
    pub fn groups(&self, strata: &[Stratum], counts: &[u32]) -> Result<Vec<NoiseGroup>, ForecastError> {
        let Self { samples: profiled, scattered, scanned, .. } = self;
        Sampled { profiled, scattered: *scattered, scanned }.groups(strata, counts)
    }

    /// The pixels that are scattered over the image.
    pub fn scattered_pixels(&self) -> &[u32] {
        &self.pixels[..self.scattered]
    }

    /// At most `most` of the scattered pixels, evenly chosen.
    #[must_use]
    pub fn thinned(&self, most: usize) -> Self {
        let count = most.min(self.scattered);
        // The middle of each of `count` equal parts.
        let picks = (0..count).map(|i| (2 * i + 1) * self.scattered / (2 * count));
        let (pixels, samples) = picks.map(|i| (self.pixels[i], self.samples[i].clone())).unzip();
        Self { counts: self.counts.clone(), pixels, samples, scattered: count, scanned: Vec::new() }
    }

    /// The scattered pixels alone, with other noise, in their order.
    #[must_use]
    pub fn with_scattered(&self, noise: impl IntoIterator<Item = PixelNoise>) -> Self {
        let samples = self.samples[..self.scattered].iter().zip(noise);
        let samples = samples.map(|(sample, noise)| NoiseSample { stratum: sample.stratum, noise });
        Self {
            counts: self.counts.clone(),
            pixels: self.scattered_pixels().to_vec(),
            samples: samples.collect(),
            scattered: self.scattered,
            scanned: Vec::new(),
        }
    }

    /// Whether noise is known: not with a single camera sample per pixel.
    pub fn is_known(&self) -> bool {
        !self.samples.is_empty() && self.samples.iter().all(|sample| !sample.noise.drops.is_empty())
    }
}

/// Strata of a frame's pixels, with the edges of lights apart.
pub struct Zones {
    /// Stratum of [`noise_strata`] of every pixel.
    stratum: Vec<u32>,
    /// Pixels of each.
    pub counts: Vec<u32>,
}

impl Zones {
    /// For a previewed frame. A pixel is at the edge of a light if it and its neighbours show different
    /// things, one of which shines or is the background.
    pub fn new(ready: &OwnFrame<'_>, preview: &Preview) -> Self {
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

    /// Additional pixels at the edges of lights, evenly spread, none of `taken`.
    pub fn edges(&self, profiled: usize, taken: &BTreeSet<u32>) -> Vec<u32> {
        let edges = self.counts.len() as u32 - 1;
        let free: Vec<u32> = (0u32..)
            .zip(&self.stratum)
            .filter(|(p, s)| **s == edges && !taken.contains(p))
            .map(|p| p.0)
            .collect();
        let wanted = (profiled / SAMPLES_PER_EDGE).min(free.len());
        // The middle of each of `wanted` equal parts.
        (0..wanted).map(|i| free[(2 * i + 1) * free.len() / (2 * wanted)]).collect()
    }

    /// The pixels that show one of these strata, ascending.
    pub fn pixels_of(&self, strata: &[usize]) -> Vec<u32> {
        let shown = (0u32..).zip(&self.stratum).filter(|(_, stratum)| strata.contains(&(**stratum as usize)));
        shown.map(|(pixel, _)| pixel).collect()
    }

    /// Noise of traced and of scanned pixels of this frame. The first traced pixels are scattered.
    pub fn noise(
        &self,
        traced: impl IntoIterator<Item = (u32, PixelNoise)>,
        scattered: usize,
        scanned: impl IntoIterator<Item = (u32, PixelNoise)>,
    ) -> FrameNoise {
        let sample = |(pixel, noise): (u32, _)| NoiseSample { stratum: self.stratum[pixel as usize], noise };
        let (pixels, samples) =
            traced.into_iter().map(|(pixel, noise)| (pixel, sample((pixel, noise)))).unzip();
        let scanned = scanned.into_iter().map(sample).collect();
        FrameNoise { counts: self.counts.clone(), pixels, samples, scattered, scanned }
    }
}
