//! Cost and benefit of camera samples by zone of a frame, from its pilot.

use crate::accuracy::Pilot;
use crate::costs::seconds;
use crate::error::{RenderError, ShotError};
use forelight_forecast::accuracy::allot::{MOST_SAMPLES, Zone, cost, samples_for_variance, whole};
use forelight_forecast::accuracy::{ErrorQuantiles, ImageNoise, NoiseGroup, Terms};
use forelight_forecast::{Calibration, ForecastError};
use forelight_protocol::{AllottedForecast, Confidence, Quantiles, SamplesForError};
use forelight_tracer::SampleCounts;

/// Cost and benefit of samples, by zone of a frame.
pub(crate) struct Allotment<'a> {
    pilot: &'a Pilot,
    image: ImageNoise,
    zones: Vec<Zone>,
    /// Of each zone, ascending.
    pixels: Vec<Vec<u32>>,
    /// Indices of the pilot's scattered samples in each zone.
    profiled: Vec<Vec<usize>>,
    /// Of the frame with the pilot's camera samples.
    cpu_seconds: Quantiles,
    /// Work of the pixels per unit of the zones' cost, as strata of cost are finer than zones.
    scale: f64,
    /// CPU seconds per unit of work, as measured by the pilot.
    pub seconds_per_work: f64,
    /// Error with the pilot's camera samples, and its root mean square.
    spread: ErrorQuantiles,
    rms: f64,
}

impl<'a> Allotment<'a> {
    pub fn new(pilot: &'a Pilot) -> Result<Self, ShotError> {
        let spp = pilot.settings.spp;
        let (work, cpu_seconds) = pilot.cost(&pilot.view, spp)?;
        let (double_work, double_seconds) = pilot.cost(&pilot.view, 2 * spp)?;
        let pixel_work = double_work.mean - work.mean;
        let noise = &pilot.noise;
        let groups = noise.groups(&pilot.noise_strata, &noise.counts)?;
        let image = ImageNoise::new(groups.iter().flat_map(|group| group.cells.iter().cloned()).collect())?;
        let zones = zones(pilot, &image, &groups)?;
        let scattered = |group: NoiseGroup| -> Vec<usize> {
            group.samples.into_iter().filter(|&i| i < noise.scattered).collect()
        };
        let uniform = image.noise_at(spp);
        Ok(Self {
            scale: pixel_work / cost(&zones, &vec![f64::from(spp); zones.len()]).max(f64::MIN_POSITIVE),
            seconds_per_work: (double_seconds.mean - cpu_seconds.mean) / pixel_work.max(f64::MIN_POSITIVE),
            spread: uniform.error(Calibration::NONE),
            rms: uniform.value.sqrt().max(f64::MIN_POSITIVE),
            pilot,
            image,
            zones,
            pixels: groups.iter().map(|group| pilot.zones.pixels_of(&group.strata)).collect(),
            profiled: groups.into_iter().map(scattered).collect(),
            cpu_seconds,
        })
    }

    /// Ratio of the CPU time at a confidence to its mean.
    pub fn surety(&self, confidence: Confidence) -> f64 {
        ratio(self.cpu_seconds.at(confidence), self.cpu_seconds.mean)
    }

    fn work_of(&self, samples: &[f64]) -> f64 {
        self.scale * cost(&self.zones, samples)
    }

    pub fn least_work(&self) -> f64 {
        self.work_of(&vec![1.0; self.zones.len()])
    }

    /// Samples of each zone that reach an error, as a share of the image's mean, with the least work.
    pub fn for_error(&self, wanted: f64, confidence: Confidence) -> Vec<f64> {
        let wanted = wanted / ratio(quantile(&self.spread, confidence), self.rms) * self.image.mean();
        samples_for_variance(&self.zones, wanted * wanted)
    }

    /// How many camera samples in every pixel cost what an error costs when samples go where they help, at each
    /// confidence. Every pixel gets at least `least`.
    pub fn samples_for_error(&self, wanted: f64, least: f64) -> SamplesForError {
        let of_one = self.least_work().max(f64::MIN_POSITIVE);
        let at = |confidence: Confidence| {
            let samples = self.for_error(wanted, confidence).into_iter().map(|n| n.max(least));
            (self.work_of(&samples.collect::<Vec<f64>>()) / of_one).clamp(least, MOST_SAMPLES)
        };
        let [p50, p80, p95] = [Confidence::P50, Confidence::P80, Confidence::P95].map(at);
        SamplesForError { p50, p80, p95 }
    }

    pub fn size(&self) -> (u32, u32) {
        (self.pilot.settings.width, self.pilot.settings.height)
    }

    /// For each pixel, how the variance of its zone falls with samples, see [`Zone::variance`].
    pub fn profiled_variance(&self) -> Vec<Terms> {
        let mut variance = vec![self.image.curve(); self.pilot.settings.pixels() as usize];
        for (pixels, zone) in self.pixels.iter().zip(&self.zones) {
            pixels.iter().for_each(|&pixel| variance[pixel as usize] = zone.variance);
        }
        variance
    }

    /// Mean samples of each zone, weighted by the cost of a sample of each pixel. The profiled pixels
    /// estimate the difference to the plain mean (a difference estimator), since costly tiles may get more
    /// samples.
    fn means(&self, counts: &SampleCounts) -> Vec<f64> {
        let of_pixel = |pixel: u32| f64::from(counts.as_slice()[pixel as usize]);
        let mean = |(pixels, profiled): (&Vec<u32>, &Vec<usize>)| {
            let plain = pixels.iter().map(|&pixel| of_pixel(pixel)).sum::<f64>() / pixels.len().max(1) as f64;
            let (mut samples, mut work, mut both) = (0.0, 0.0, 0.0);
            for &i in profiled {
                let (here, took) = (of_pixel(self.pilot.noise.pixels[i]), self.pilot.pixel_work[i] as f64);
                (samples, work, both) = (samples + here, work + took, both + here * took);
            }
            let tilt = if work > 0.0 { both / work - samples / profiled.len() as f64 } else { 0.0 };
            (plain + tilt).max(1.0)
        };
        self.pixels.iter().zip(&self.profiled).map(mean).collect()
    }

    /// Forecast of a frame with the same mean everywhere, corrected for the distribution of samples.
    pub fn forecast(&self, counts: &SampleCounts) -> Result<AllottedForecast, ShotError> {
        let even = (counts.range().2.round() as u32).max(1);
        let (work, cpu_seconds) = self.pilot.cost(&self.pilot.view, even)?;
        let (double_work, double_seconds) = self.pilot.cost(&self.pilot.view, 2 * even)?;
        let evenly = vec![f64::from(even); self.zones.len()];
        let more = ratio(cost(&self.zones, &self.means(counts)), cost(&self.zones, &evenly)) - 1.0;
        Ok(AllottedForecast {
            work: moved(&work, more * (double_work.mean - work.mean)),
            cpu_seconds: moved(&cpu_seconds, more * (double_seconds.mean - cpu_seconds.mean)),
            profiling_work: self.pilot.overhead.work,
            profiling_cpu_seconds: seconds(self.pilot.overhead.cpu_nanos),
        })
    }
}

fn zones(pilot: &Pilot, image: &ImageNoise, groups: &[NoiseGroup]) -> Result<Vec<Zone>, ForecastError> {
    let of_image = image.curve();
    let zone = |group: &NoiseGroup| {
        let work: Vec<f64> = group.samples.iter().map(|&i| pilot.pixel_work[i] as f64).collect();
        Zone::new((image, of_image), &group.cells, &work, pilot.settings.spp)
    };
    groups.iter().map(zone).collect()
}

pub(crate) fn quantile(error: &ErrorQuantiles, confidence: Confidence) -> f64 {
    match confidence {
        Confidence::P50 => error.p50,
        Confidence::P80 => error.p80,
        Confidence::P95 => error.p95,
    }
}

/// 1 if either is 0.
fn ratio(part: f64, whole: f64) -> f64 {
    if part > 0.0 && whole > 0.0 { part / whole } else { 1.0 }
}

fn moved(quantiles: &Quantiles, change: f64) -> Quantiles {
    let factor = ratio((quantiles.mean + change).max(0.0), quantiles.mean);
    let Quantiles { mean, p50, p80, p95 } = *quantiles;
    Quantiles { mean: mean * factor, p50: p50 * factor, p80: p80 * factor, p95: p95 * factor }
}

/// Spreads mean sample counts of sets of pixels over the pixels. Pixels in no set get one sample.
pub(crate) fn laid_out(
    pixels: usize,
    sets: &[Vec<u32>],
    samples: &[f64],
) -> Result<SampleCounts, RenderError> {
    let mut counts = vec![1u16; pixels];
    for (set, &samples) in sets.iter().zip(samples) {
        for (&pixel, n) in set.iter().zip(whole(samples, set.len())) {
            counts[pixel as usize] = n.min(MOST_SAMPLES as u32) as u16;
        }
    }
    Ok(SampleCounts::new(counts)?)
}
