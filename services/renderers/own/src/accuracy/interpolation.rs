//! The error that an irradiance cache adds: by interpolation, and by the noise of its records. It does not
//! fall with camera samples, since all of them read the same records.
//!
//! The records that the profiled pixels read are filled, so a pixel's value `c` is close to the image's. Only
//! the averaging of similar records is missing, and the noise of rays to secondary lights counts as the
//! cache's. So the result is an upper estimate. `c` is compared to two values of the same pixel, gathered with
//! more divisions: `g` from the *same* camera samples, `h` from independent ones. With e the error of the camera
//! samples that c and g share, b that of the cache, and u and v the remaining noise of g and h,
//!
//! ```text
//! E[(c − g)(c − h)] = E[(b − u)(e + b − v)] = E[b²] :
//! ```
//!
//! This is an unbiased estimate of the cache's part alone. It may be negative for a single pixel.

use super::gathers::{LESS_NOISY, cost, scaled, times_the_rays};
use super::pilot::Pilot;
use crate::accuracy::observer::{AccuracyObserver, is_cancelled, traced};
use crate::error::ShotError;
use crate::frame::OwnFrame;
use crate::profile::noise::FrameNoise;
use crate::shot::OwnShot;
use forelight_forecast::accuracy::PixelNoise;
use forelight_protocol::{RenderSettings, Spent};

/// Factors on the divisions of reference gathers. The first with at most [`MOST_TIMES`] the rays is used.
const FINER: [u32; 2] = [4, 2];

const MOST_TIMES: f64 = 8.0;

const MOST_DIVISIONS: u32 = 65_536;

/// The image's seed with these bits flipped is the seed of the independent values.
const OTHER_SEED: u64 = 0x7275_7468;

/// Most pixels on which a cache is compared to gathers. Each of them reads dozens of records.
const PIXELS: usize = 64;

/// Reference values of scattered pixels, without a cache.
pub struct Truth {
    /// These pixels, with the noise of their gathers.
    gathered: FrameNoise,
    same: Vec<[f32; 3]>,
    independent: Vec<[f32; 3]>,
    pub spent: Spent,
}

impl Truth {
    pub fn new(
        shot: &OwnShot,
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
            let ready = shot.frame(frame, settings)?;
            let traced = traced(&ready, pixels, observer)?;
            spent = spent.plus(ready.spent_on_setup()).plus(cost(&traced));
            Ok(traced.into_iter().map(|(pixel, _)| pixel.color).collect())
        };
        let (same, independent) = (colors(&finer)?, colors(&other)?);
        Ok(Self { gathered, same, independent, spent })
    }

    /// Completes a pilot with a cache: the noise of its camera samples, and the error that interpolation
    /// adds. Both come from the pixels of these reference values.
    pub fn interpolated(
        &self,
        ready: &OwnFrame<'_>,
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
