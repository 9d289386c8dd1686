//! The variance of one pixel at any number of camera samples, estimated from a single render of it.
//!
//! Let V(n) be the variance of the mean of n samples, and a and b the means of two neighbouring blocks of n.
//! Blocks of a scrambled sequence that are aligned to powers of two are exchangeable (Owen 1995). So a and b
//! have the same distribution, a + b and a − b are uncorrelated, and
//!
//! ```text
//! V(n) = V(2 n) + E[(a − b)² / 4] ,
//! ```
//!
//! whatever the correlation of a and b. So squared half-differences of blocks are unbiased estimates of the
//! *drops* V(1) − V(2), V(2) − V(4), …. Only the variance after the last drop remains unknown.

use serde::{Deserialize, Serialize};

/// Statistics of the camera samples of one pixel.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PixelNoise {
    /// Mean of the samples, over the three channels.
    pub brightness: f64,
    /// Estimates of V(2ᵏ) − V(2ᵏ⁺¹): means over the channels, in brightness squared; ⌊log₂ n⌋ for n samples.
    pub drops: Vec<f64>,
    /// Estimate of the squared bias, mean over the channels: the part of the error that no number of samples
    /// removes, for example that of interpolation. It may be negative, because it is estimated as a product.
    #[serde(default)]
    pub bias_square: f64,
}

/// Collects the camera samples of a pixel in their order. Memory grows with the logarithm of their number.
#[derive(Clone, Debug, Default)]
pub struct PixelSamples {
    count: u64,
    sum: f64,
    levels: Vec<Level>,
}

/// Statistics of the blocks of 2ᵏ samples.
#[derive(Clone, Debug, Default)]
struct Level {
    /// Mean of a block whose neighbour is still incomplete.
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

    /// Statistics of the samples so far.
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
        // Pairs (1, 3) and (5, 9) give (1 + 4) / 2, blocks 2 and 7 give 2.5². The channels scale these by 1,
        // 4 and 0; their mean divides by 3.
        assert_eq!(noise.drops, [2.5 * 5.0 / 3.0, 6.25 * 5.0 / 3.0]);
    }

    #[test]
    fn samples_beyond_the_last_whole_pair_count_for_the_brightness_alone() {
        assert_eq!(of(&[1.0, 3.0, 5.0]).drops, of(&[1.0, 3.0]).drops);
        assert_eq!(of(&[7.0]), PixelNoise { brightness: 7.0, ..PixelNoise::default() });
        assert_eq!(of(&[]), PixelNoise::default());
    }
}
