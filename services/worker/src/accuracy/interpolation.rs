//! What an irradiance cache adds to the error: that of interpolation, and that of the records themselves. It does not fall with
//! camera samples, for all of them read the same records.
//!
//! It is found out on the profiled pixels. The records that they read are gathered, so that their values `c` are those that they
//! would have in the image, but for the averaging of records that agree, which takes more of them: what is found is an upper
//! estimate. Against them are held two gathered values of the same pixels without a cache, of more divisions: `g`
//! from the *same* camera samples, `h` from independent ones. With t for the converged pixel, e for the error of the camera samples
//! that c and g share, b for that of the cache, and u and v for what else is random in g and h,
//!
//! ```text
//! E[(c − g)(c − h)] = E[(b − u)(e + b − v)] = E[b²] :
//! ```
//!
//! an unbiased estimate of the cache's part alone. That of a single pixel may be negative; the mean over the image is hardly.

use super::gathers::{LESS_NOISY, cost, scaled, times_the_rays};
use super::pilot::Pilot;
use super::{AccuracyObserver, is_cancelled, traced};
use crate::profile::ShotError;
use crate::profile::noise::FrameNoise;
use crate::renderer::{FrameRenderer, Renderer};
use forelight_forecast::accuracy::PixelNoise;
use forelight_protocol::{RenderSettings, Spent};

/// Gathers of the truth have that many times the divisions that were asked for, that their noise does not hide what is looked for; the first of
/// these with which they have at most [`MOST_TIMES`] the rays, or as many: with several bounces rays grow with a power of the divisions.
const FINER: [u32; 2] = [4, 2];

/// See [`FINER`].
const MOST_TIMES: f64 = 8.0;

/// Most divisions that settings may have.
const MOST_DIVISIONS: u32 = 65_536;

/// The seed of the independent values is the image's with these bits flipped.
const OTHER_SEED: u64 = 0x7275_7468;

/// Pixels at most on which a cache is held against gathers: each of them reads dozens of records.
const PIXELS: usize = 64;

/// Values of scattered pixels without a cache.
pub struct Truth {
    /// These pixels, with what gathers say of them.
    gathered: FrameNoise,
    same: Vec<[f32; 3]>,
    independent: Vec<[f32; 3]>,
    /// What finding them out took.
    pub spent: Spent,
}

impl Truth {
    /// Of the scattered pixels of a pilot without a cache.
    pub fn new(
        renderer: &dyn Renderer,
        frame: u32,
        pilot: &Pilot,
        observer: &dyn AccuracyObserver,
    ) -> Result<Self, ShotError> {
        let finer_by = |times: u32| RenderSettings {
            ambient_divisions: pilot.settings.ambient_divisions.saturating_mul(times).min(MOST_DIVISIONS),
            ..pilot.settings.clone()
        };
        let finer = FINER
            .map(finer_by)
            .into_iter()
            .find(|finer| times_the_rays(&pilot.settings, finer) <= MOST_TIMES)
            .unwrap_or_else(|| pilot.settings.clone());
        let other = RenderSettings { seed: finer.seed ^ OTHER_SEED, ..finer.clone() };
        let gathered = pilot.noise.thinned(PIXELS);
        let pixels = gathered.scattered_pixels();
        let mut spent = Spent::default();
        let mut colors = |settings: &RenderSettings| -> Result<Vec<[f32; 3]>, ShotError> {
            let ready = renderer.frame(frame, settings)?;
            let traced = traced(&*ready, pixels, observer)?;
            spent = spent.plus(ready.spent_on_setup()).plus(cost(&traced));
            Ok(traced.into_iter().map(|(pixel, _)| pixel.color).collect())
        };
        let (same, independent) = (colors(&finer)?, colors(&other)?);
        Ok(Self { gathered, same, independent, spent })
    }

    /// Completes a pilot with a cache by the pixels of the pilot without one that the truth is of: what its camera samples say, and what
    /// interpolation adds.
    pub fn interpolated(
        &self,
        ready: &dyn FrameRenderer,
        gathered: &FrameNoise,
        pilot: &mut Pilot,
        observer: &dyn AccuracyObserver,
    ) -> Result<(), ShotError> {
        let pixels = self.gathered.scattered_pixels();
        let filling = ready.fill_for(pixels, &|| is_cancelled(observer)).ok_or(ShotError::Cancelled)?;
        let traced = traced(ready, pixels, observer)?;
        pilot.spent = pilot.spent.plus(filling).plus(cost(&traced));
        let noise = traced.into_iter().enumerate().map(|(i, (pixel, noise))| PixelNoise {
            bias_square: product(pixel.color, self.same[i], self.independent[i]),
            ..noise
        });
        let cached = self.gathered.with_scattered(noise);
        pilot.noise = scaled(&pilot.noise_strata, gathered, &self.gathered, &cached, LESS_NOISY)?;
        pilot.interpolation = Some(cached);
        Ok(())
    }
}

/// (c − g)(c − h), mean over channels.
fn product(cached: [f32; 3], same: [f32; 3], independent: [f32; 3]) -> f64 {
    let channel = |c: usize| {
        let [cached, same, independent] = [cached[c], same[c], independent[c]].map(f64::from);
        (cached - same) * (cached - independent)
    };
    (0..3).map(channel).sum::<f64>() / 3.0
}
