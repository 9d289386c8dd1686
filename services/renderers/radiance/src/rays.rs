//! Rays of pixels, by the program vwrays.

use crate::installation::{MESSAGES, Radiance};
use crate::scene::{Scene, SceneFrame};
use forelight_random::hash;
use forelight_renderer::door::{Common, RendererError, Run};
use forelight_renderer::process::run_on_files;
use std::fmt::Write;
use std::fs::{self, File};
use std::ops::Range;

/// Origin and direction of a ray. A direction of zero: the view has nothing there.
pub(crate) type Ray = [f64; 6];

/// Ratios of the additive sequence that spreads samples over a pixel: powers of the inverse of the plastic
/// number (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
const SPREAD: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];

/// Rays of some pixels, and what they took.
pub(crate) struct Rays {
    /// All samples of the first pixel, then those of the next.
    pub rays: Vec<Ray>,
    /// CPU time of vwrays, nanoseconds.
    pub cpu_nanos: u64,
}

/// Whether the view has nothing at this ray's pixel.
pub(crate) fn is_nothing(ray: &Ray) -> bool {
    ray[3..].iter().all(|&component| component == 0.0)
}

/// Rays of these samples of pixels, which are numbered in rows from the top.
pub(crate) fn rays_of(
    (radiance, scene, frame): (&Radiance, &Scene, &SceneFrame),
    common: &Common,
    pixels: &[u32],
    samples: Range<u32>,
    run: &Run<'_>,
) -> Result<Rays, RendererError> {
    let folder = tempfile::tempdir_in(scene.home.path()).map_err(RendererError::io(scene.home.path()))?;
    let (places, rays) = (folder.path().join("places"), folder.path().join("rays"));
    let text = positions(common, pixels, samples.clone());
    fs::write(&places, text).map_err(RendererError::io(&places))?;
    let program = radiance
        .program("vwrays", &scene.folder, scene.home.path())
        .args(["-i", "-fd"])
        .args(frame.view.arguments.iter().cloned())
        .args(["-x".to_owned(), common.width.to_string(), "-y".to_owned(), common.height.to_string()])
        .args(["-pa", "0"]);
    let from = File::open(&places).map_err(RendererError::io(&places))?;
    let to = File::create(&rays).map_err(RendererError::io(&rays))?;
    let finished = run_on_files(&program, MESSAGES, run, from, to)?;
    let bytes = fs::read(&rays).map_err(RendererError::io(&rays))?;
    let (numbers, _) = bytes.as_chunks::<8>();
    let (read, rest) = numbers.as_chunks::<6>();
    let expected = pixels.len() * samples.len();
    if read.len() != expected || !rest.is_empty() {
        let reason = format!("vwrays wrote {} rays for {expected} samples", read.len());
        return Err(RendererError::Answer(reason));
    }
    let rays = read.iter().map(|ray| ray.map(f64::from_ne_bytes)).collect();
    Ok(Rays { rays, cpu_nanos: finished.usage.cpu_nanos })
}

/// Places of samples, as vwrays reads them: columns, and rows from below. A single sample is in the middle of
/// its pixel.
fn positions(common: &Common, pixels: &[u32], samples: Range<u32>) -> String {
    let mut text = String::with_capacity(pixels.len() * samples.len() * 24);
    for &pixel in pixels {
        let (x, y) = (pixel % common.width, common.height - 1 - pixel / common.width);
        for sample in samples.clone() {
            let [dx, dy] = place(common, pixel, sample);
            // Writing to a string cannot fail. vwrays adds one half.
            let _ = writeln!(text, "{} {}", f64::from(x) + dx - 0.5, f64::from(y) + dy - 0.5);
        }
    }
    text
}

/// Place of a sample in its pixel, 0 to 1.
fn place(common: &Common, pixel: u32, sample: u32) -> [f64; 2] {
    if common.samples == 1 {
        return [0.5; 2];
    }
    let own = hash(hash(u64::from(common.seed)) ^ u64::from(pixel));
    let start = [own >> 32, own & 0xffff_ffff].map(|half| half as f64 / 4_294_967_296.0);
    [0, 1].map(|axis| (start[axis] + SPREAD[axis] * f64::from(sample)).fract())
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMMON: Common = Common { width: 4, height: 3, samples: 1, seed: 7 };

    #[test]
    fn a_single_sample_is_in_the_middle_and_rows_count_from_below() {
        assert_eq!(positions(&COMMON, &[0, 5, 11], 0..1), "0 2\n1 1\n3 0\n");
    }

    #[test]
    fn samples_are_spread_over_their_pixel_and_differ_by_seed() {
        let common = Common { samples: 16, ..COMMON };
        let places: Vec<[f64; 2]> = (0..16).map(|sample| place(&common, 5, sample)).collect();
        for quarter in 0..4 {
            let inside = |p: &&[f64; 2]| (p[0] * 2.0) as u32 + 2 * (p[1] * 2.0) as u32 == quarter;
            assert!((3..=5).contains(&places.iter().filter(inside).count()), "{quarter}");
        }
        assert_ne!(place(&common, 5, 0), place(&Common { seed: 8, ..common }, 5, 0));
        assert_ne!(place(&common, 5, 0), place(&common, 6, 0));
    }
}
