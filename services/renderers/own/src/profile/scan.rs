//! The first camera samples of many pixels, for the image's error.
//!
//! See [`forelight_forecast::accuracy::Sampled`] for why.

use crate::costs::spent;
use crate::frame::OwnFrame;
use forelight_forecast::accuracy::{PixelNoise, PixelSamples};
use forelight_forecast::probes;
use forelight_protocol::Spent;
use forelight_random::hash;
use forelight_tracer::Pixel;

/// Most camera samples of a scanned pixel: three doublings. (Six rooms at 240 × 135, 16 seeds, the same number of
/// camera samples in all: with four of twice as many pixels, errors at one sample spread 0.05 to 0.26 in their
/// logarithm, with eight 0.04 to 0.22. At 16 samples, it is 0.09 to 0.45 and 0.06 to 0.35.)
const SAMPLES: u32 = 8;

/// Most pixels to scan. They have at most as many camera samples as all profiled pixels.
const MOST: u64 = 2048;

/// Scans a frame of which `profiled` pixels were profiled. Returns the noise of scanned pixels, and their cost.
/// There are none if pixels have a single camera sample, or half of them were profiled. `None` if `stop` returned
/// `true`.
pub fn scan(
    ready: &OwnFrame<'_>,
    profiled: usize,
    seed: u64,
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<(Vec<(u32, PixelNoise)>, Spent)> {
    let spp = ready.tracer.settings().spp;
    // At most the pixels of an image.
    let (samples, pixels) = (SAMPLES.min(spp), ready.frame().camera.pixels() as u32);
    if samples < 2 || 2 * profiled as u64 >= u64::from(pixels) {
        return Some((Vec::new(), Spent::default()));
    }
    let count = (profiled as u64 * u64::from(spp) / u64::from(samples)).min(MOST) as u32;
    // Other pixels in each frame: the errors of frames are taken as independent.
    let seed = hash(seed ^ hash(u64::from(ready.frame().number)));
    // One pixel at random in each of so many runs of pixels.
    let pixels: Vec<u32> = probes(pixels, count, seed).into_iter().map(|probe| probe.at).collect();
    let (traced, cost) = ready.tracer.first_samples(&pixels, samples, stop)?;
    let noise = pixels.into_iter().zip(traced).map(|(pixel, after)| (pixel, noise_of(&after)));
    Some((noise.collect(), spent(cost)))
}

/// Noise of a pixel from its states after one sample, after two, and so on.
fn noise_of(after: &[Pixel]) -> PixelNoise {
    let mut samples = PixelSamples::default();
    let mut before = [0.0; 3];
    for (count, pixel) in (1u32..).zip(after) {
        let sum = pixel.color.map(|mean| f64::from(mean) * f64::from(count));
        samples.push(std::array::from_fn(|channel| (sum[channel] - before[channel]) as f32));
        before = sum;
    }
    samples.noise()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::kitchen;
    use forelight_protocol::{RenderSettings, RenderSettingsRequest};

    #[test]
    fn a_scan_has_at_most_eight_samples_of_a_pixel_and_as_many_in_all_as_profiled_pixels() {
        let shot = kitchen();
        let plain = RenderSettingsRequest { ambient_divisions: Some(1), ..RenderSettingsRequest::default() };
        let goes_on = || false;
        for (spp, pixels, doublings) in [(1, 0, 0), (2, 100, 1), (3, 100, 1), (8, 100, 3), (64, 800, 3)] {
            let ready = shot.frame(0, &RenderSettings { spp, ..plain.complete((64, 36)) }).unwrap();
            let (scanned, cost) = scan(&ready, 100, 1, &goes_on).unwrap();
            assert_eq!((scanned.len(), cost.work > 0), (pixels, spp > 1), "{spp}");
            assert!(scanned.iter().all(|(_, noise)| noise.drops.len() == doublings), "{spp}");
            assert!(scanned.is_sorted_by(|a, b| a.0 < b.0), "each pixel once");
            // Half of the image was profiled.
            assert_eq!(scan(&ready, 64 * 18, 1, &goes_on).unwrap(), (Vec::new(), Spent::default()));
            assert_eq!(scan(&ready, 100, 1, &|| true).is_none(), spp > 1);
        }
    }

    #[test]
    fn the_noise_of_means_is_that_of_their_samples() {
        let all = [[1.0f32, 4.0, 0.5], [3.0, 4.0, 0.25], [0.0, 2.0, 8.0], [5.0, 0.0, 1.0]];
        let mean = |count: usize| -> [f32; 3] {
            std::array::from_fn(|c| all[..count].iter().map(|sample| sample[c]).sum::<f32>() / count as f32)
        };
        let after: Vec<Pixel> =
            (1..=4).map(|count| Pixel { color: mean(count), ..Pixel::default() }).collect();
        let mut samples = PixelSamples::default();
        all.iter().for_each(|&sample| samples.push(sample));
        let (found, known) = (noise_of(&after), samples.noise());
        assert!((found.brightness - known.brightness).abs() < 1e-6);
        assert_eq!(found.drops.len(), 2);
        assert!(found.drops.iter().zip(&known.drops).all(|(a, b)| (a / b - 1.0).abs() < 1e-5), "{found:?}");
    }
}
