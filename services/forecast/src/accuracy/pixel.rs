//! The variance of one pixel, at any number of camera samples, from the samples of a single render of it.
//!
//! Let V(n) be the variance of the mean of n samples. Two neighbouring blocks of n samples each, of means a and b, have the same
//! distribution (blocks of a scrambled sequence that are aligned to powers of two are exchangeable: Owen 1995), and (a + b) / 2 is the
//! mean of 2 n. From a = (a + b)/2 + (a − b)/2, and since sum and difference of exchangeable numbers are uncorrelated,
//!
//! ```text
//! V(n) = V(2 n) + E[(a − b)² / 4] ,
//! ```
//!
//! whatever the correlation of a and b is. So the squared half-differences of blocks are unbiased estimates of by how much each
//! doubling lowers the variance: the *drops* V(1) − V(2), V(2) − V(4), …, and all of them but the last V are known from one render.

use serde::{Deserialize, Serialize};

/// What the camera samples of one pixel say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PixelNoise {
    /// Mean of the samples over the three channels.
    pub brightness: f64,
    /// Estimates of V(2ᵏ) − V(2ᵏ⁺¹), mean over channels, for k = 0, 1, …: as many as the number of samples can be halved.
    pub drops: Vec<f64>,
    /// Estimate of the square by which the pixel is off whatever its number of samples, as by interpolation, mean over channels.
    /// Of a single pixel it may be negative, where it is estimated as a product.
    #[serde(default)]
    pub bias_square: f64,
}

/// Gathers the camera samples of a pixel in their order, in memory that grows with the logarithm of their number.
#[derive(Clone, Debug, Default)]
pub struct PixelSamples {
    count: u64,
    sum: f64,
    levels: Vec<Level>,
}

/// Blocks of 2ᵏ samples.
#[derive(Clone, Debug, Default)]
struct Level {
    /// Mean of a block whose neighbour has not come yet.
    waiting: Option<[f64; 3]>,
    squares: f64,
    pairs: u64,
}

impl PixelSamples {
    /// Adds the next sample.
    pub fn push(&mut self, sample: [f32; 3]) {
        let mut mean = sample.map(f64::from);
        self.count += 1;
        self.sum += mean.iter().sum::<f64>();
        for k in 0.. {
            if k == self.levels.len() {
                self.levels.push(Level::default());
            }
            let level = &mut self.levels[k];
            let Some(first) = level.waiting.take() else {
                level.waiting = Some(mean);
                return;
            };
            let halves: [f64; 3] = std::array::from_fn(|c| 0.5 * (first[c] - mean[c]));
            level.squares += halves.iter().map(|half| half * half).sum::<f64>() / 3.0;
            level.pairs += 1;
            mean = std::array::from_fn(|c| 0.5 * (first[c] + mean[c]));
        }
    }

    /// What they say.
    pub fn noise(&self) -> PixelNoise {
        let complete = self.levels.iter().filter(|level| level.pairs > 0);
        PixelNoise {
            brightness: self.sum / (3.0 * self.count.max(1) as f64),
            drops: complete.map(|level| level.squares / level.pairs as f64).collect(),
            bias_square: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[f32]) -> PixelNoise {
        let mut samples = PixelSamples::default();
        values.iter().for_each(|&value| samples.push([value, 2.0 * value, 0.0]));
        samples.noise()
    }

    #[test]
    fn the_drops_are_mean_squares_of_half_differences_of_blocks() {
        let noise = of(&[1.0, 3.0, 5.0, 9.0]);
        assert_eq!(noise.brightness, 3.0 * 4.5 / 3.0);
        // Pairs (1, 3), (5, 9): (1 + 4) / 2; blocks 2 and 7: 2.5². Channels count 1, 4, 0 times that, over 3.
        assert_eq!(noise.drops, [2.5 * 5.0 / 3.0, 6.25 * 5.0 / 3.0]);
    }

    #[test]
    fn samples_beyond_the_last_whole_pair_count_for_the_brightness_alone() {
        assert_eq!(of(&[1.0, 3.0, 5.0]).drops, of(&[1.0, 3.0]).drops);
        assert_eq!(of(&[7.0]), PixelNoise { brightness: 7.0, ..PixelNoise::default() });
        assert_eq!(of(&[]), PixelNoise::default());
    }
}
