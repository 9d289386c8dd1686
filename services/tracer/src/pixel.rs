//! Pixels: finished, and in progress.

use crate::cost::WorkByRay;
use crate::random::Drawn;
use glam::{DVec3, Vec3};

/// One finished pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixel {
    /// Linear Rec. 709 radiance, the mean over the samples.
    pub color: [f32; 3],
    /// Rays by category, in the order of [`crate::RAY_NAMES`].
    pub rays: [u32; 7],
    /// Deterministic work.
    pub work: u64,
    /// Work by the category of the ray that caused it.
    pub work_by_ray: WorkByRay,
    /// The part of `work` that later samples do not have: the rays beyond the minimum at points that no cache
    /// record covers ([`crate::UncoveredGathers`]). All other work is proportional to the number of samples.
    pub extra_work: u64,
    /// CPU time, nanoseconds.
    pub cpu_nanos: u64,
    /// Number of cache reads at points that no record covers, where the sample gathered for itself.
    pub uncovered: u32,
    /// Stratum that the first camera sample met, or [`Pixel::NOTHING`].
    pub stratum: u32,
    /// The strata that all its camera samples met first.
    pub coverage: Coverage,
}

impl Pixel {
    /// Stratum of a pixel whose first sample met no surface.
    pub const NOTHING: u32 = u32::MAX;
}

impl Default for Pixel {
    /// A pixel without samples: black.
    fn default() -> Self {
        Self {
            color: [0.0; 3],
            rays: [0; 7],
            work: 0,
            work_by_ray: [0; 7],
            extra_work: 0,
            cpu_nanos: 0,
            uncovered: 0,
            stratum: Self::NOTHING,
            coverage: Coverage::NONE,
        }
    }
}

/// How many camera samples of a pixel met which stratum first. A pixel of more than [`Coverage::MOST`] strata
/// keeps those that it met first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Coverage {
    /// The strata, in the order in which they were met. [`Pixel::NOTHING`] where there is none.
    pub strata: [u32; Self::MOST],
    /// Number of samples that met each.
    pub samples: [u16; Self::MOST],
    /// Number of samples, also of those that met nothing. Samples beyond its largest value are not counted.
    pub all: u16,
}

impl Coverage {
    /// Largest number of strata of a pixel.
    pub const MOST: usize = 4;
    /// A pixel without samples.
    pub const NONE: Self = Self { strata: [Pixel::NOTHING; Self::MOST], samples: [0; Self::MOST], all: 0 };

    /// Counts one sample and the stratum that it met.
    pub(crate) fn add(&mut self, stratum: Option<u32>) {
        if self.all == u16::MAX {
            return;
        }
        self.all += 1;
        let Some(stratum) = stratum else { return };
        let place = self.strata.iter().position(|&known| known == stratum || known == Pixel::NOTHING);
        if let Some(place) = place {
            self.strata[place] = stratum;
            self.samples[place] += 1;
        }
    }
}

/// What a camera sample shows, or the mean over a pixel's samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Feature {
    /// Colour of the surface, or of the light: 0 to 1.
    pub albedo: Vec3,
    /// Unit normal on the viewer's side in world space. Zero where nothing is met. Means are shorter.
    pub normal: Vec3,
}

/// Callback for finished pixels, each with its row-major index.
pub type PixelsFinished<'a> = dyn Fn(&[(u32, Pixel)]) + Sync + 'a;

/// A pixel that can receive more samples.
#[derive(Debug, Clone, Default)]
pub(crate) struct Underway {
    /// How far its random sequences are drawn.
    pub drawn: Drawn,
    /// Sum of its samples' radiance, in order.
    pub sum: DVec3,
    /// Sum of the squared radiance, averaged over the channels.
    pub squares: f64,
    pub samples: u32,
    /// The sum at the last two sample counts that were powers of two.
    pub before: [(u32, DVec3); 2],
    /// Cost of its samples. The colour is only valid after [`Self::finished`].
    pub pixel: Pixel,
}

impl Underway {
    /// Adds the radiance of one sample.
    pub fn add(&mut self, sample: Vec3) {
        self.sum += sample.as_dvec3();
        self.samples += 1;
        if self.samples.is_power_of_two() {
            self.before = [self.before[1], (self.samples, self.sum)];
        }
    }

    /// The finished pixel. It is black if there are no samples.
    pub fn finished(&self) -> Pixel {
        let color = (self.sum / f64::from(self.samples.max(1))).as_vec3().to_array();
        Pixel { color, ..self.pixel }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_counts_the_first_strata_and_all_samples() {
        let mut coverage = Coverage::NONE;
        for stratum in [Some(7), None, Some(2), Some(7), Some(5), Some(0), Some(9), Some(9), Some(2)] {
            coverage.add(stratum);
        }
        assert_eq!(coverage, Coverage { strata: [7, 2, 5, 0], samples: [2, 2, 1, 1], all: 9 });
    }

    #[test]
    fn coverage_stops_counting_before_it_overflows() {
        let mut coverage = Coverage::NONE;
        (0..70_000).for_each(|_| coverage.add(Some(1)));
        assert_eq!((coverage.samples[0], coverage.all), (u16::MAX, u16::MAX));
    }
}
