//! The numbers of an explanation.

use forelight_forecast::{Strategy, StratumSum};
use forelight_protocol::{FixedCosts, StratumName, UncoveredGathers};

use crate::error::QuoteError;
use crate::measured::Measured;

/// Pixels of one kind, and their expected work.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct ShownWork {
    /// Object and material. `None` for the background.
    pub shows: Option<StratumName>,
    pub pixels: u64,
    pub samples: u64,
    pub work: f64,
    pub profiled: ProfiledWork,
}

/// Cost of profiled pixels in parts. Only the proportions count.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub(super) struct ProfiledWork {
    /// By the ray that caused it, in the order of [`forelight_protocol::Rays::NAMES`].
    pub by_ray: [f64; 7],
    pub work: f64,
    /// Work that does not grow with the camera samples: see [`UncoveredGathers`].
    pub extra: f64,
}

impl ProfiledWork {
    fn plus(self, other: Self) -> Self {
        let mut by_ray = self.by_ray;
        by_ray.iter_mut().zip(other.by_ray).for_each(|(sum, work)| *sum += work);
        Self { by_ray, work: self.work + other.work, extra: self.extra + other.extra }
    }
}

#[derive(Clone, PartialEq, Debug)]
pub(super) struct Amounts {
    /// The frame. `None` for all frames.
    pub frame: Option<u32>,
    pub work: f64,
    /// Pixels by what they show. Each pixel is in one entry.
    pub pixels: Vec<ShownWork>,
    /// True if the entries are objects. Blind strategies do not tell objects apart.
    pub told_apart: bool,
    /// True if the cost of pixels is known to grow with the camera samples.
    pub by_samples: bool,
    /// Work of filling the irradiance cache by level, starting with the level of the camera's hits. Empty
    /// without a cache.
    pub records_work: Vec<f64>,
    pub fixed: Option<FixedCosts>,
    /// What else the costs consist of that do not depend on pixels, by name. Only the proportions count.
    pub fixed_parts: Vec<(String, f64)>,
    /// True if the frames share an irradiance cache. No number here includes building it.
    pub shares_cache: bool,
    /// Expected rays by category, in the order of [`forelight_protocol::Rays::NAMES`].
    pub rays: [f64; 7],
    /// Gathers at uncovered points. `None` without a cache.
    pub uncovered: Option<UncoveredGathers>,
}

impl Amounts {
    /// Share of the total work, 0 to 1.
    pub fn share(&self, part: f64) -> f64 {
        if self.work > 0.0 { part / self.work } else { 0.0 }
    }

    pub fn pixel_work(&self) -> f64 {
        self.pixels.iter().map(|shown| shown.work).sum()
    }
}

impl Measured<'_> {
    pub(super) fn amounts(&self, frame: Option<u32>) -> Result<Amounts, QuoteError> {
        let estimate = self.estimate()?;
        let (total, sums) = match frame {
            None => {
                let frames = estimate.shot.frames.iter().map(|frame| &frame.strata[..]);
                (&estimate.shot.total, StratumSum::over(frames))
            }
            Some(number) => {
                let mut frames = estimate.shot.frames.iter();
                let one = frames.find(|frame| frame.number == i64::from(number));
                let one = one.ok_or(QuoteError::NoFrame(number))?;
                (&one.total, StratumSum::over(std::iter::once(&one.strata[..])))
            }
        };
        let told_apart = matches!(self.strategy, Strategy::PaperSnapshot | Strategy::Snapshot);
        // Objects come first, then the background, then the records.
        let (pixels, records) = sums.split_at(estimate.populations.pixel_strata.min(sums.len()));
        let shown = |(place, sum): (usize, &StratumSum)| ShownWork {
            shows: estimate.populations.names.get(place).filter(|_| told_apart).cloned(),
            pixels: sum.pixels,
            samples: sum.samples,
            work: sum.work,
            profiled: ProfiledWork::default(),
        };
        let mut pixels: Vec<ShownWork> = pixels.iter().enumerate().map(shown).collect();
        self.add_profiled(&mut pixels, &estimate.sampled);
        Ok(Amounts {
            frame,
            work: total.work.mean,
            pixels,
            told_apart,
            by_samples: true,
            records_work: records.iter().map(|sum| sum.work).collect(),
            fixed: self.fixed_costs(frame),
            fixed_parts: Vec::new(),
            shares_cache: self.shared.is_some(),
            rays: total.rays.map(|rays| rays.mean),
            uncovered: self.profiles.iter().find_map(|profile| profile.result.uncovered),
        })
    }

    /// Adds the cost of the profiled pixels to their entries. `sampled` is the stratum of each profiled
    /// pixel, by profile.
    fn add_profiled(&self, pixels: &mut [ShownWork], sampled: &[Vec<u32>]) {
        for (profile, strata) in self.profiles.iter().zip(sampled) {
            for (place, (sample, &stratum)) in profile.result.samples.iter().zip(strata).enumerate() {
                let Some(shown) = pixels.get_mut(stratum as usize) else { continue };
                let sums = &mut shown.profiled;
                sums.by_ray.iter_mut().zip(sample.work_by_ray).for_each(|(sum, work)| *sum += work as f64);
                let beside = profile.result.shared_samples.get(place).filter(|_| self.shared.is_some());
                let (work, extra) = match beside {
                    Some(sample) => (sample.work, sample.extra_work),
                    None => (sample.work, sample.extra_work),
                };
                sums.work += work as f64;
                sums.extra += extra as f64;
            }
        }
    }
}

/// Work of the pixels by ray. Each entry is divided like its profiled pixels, or like all profiled pixels if
/// it has none. `None` if no proportion is known.
pub(super) fn work_by_ray(pixels: &[ShownWork]) -> Option<[f64; 7]> {
    let sum = |of: &ProfiledWork| of.by_ray.iter().sum::<f64>();
    let all = all_profiled(pixels);
    let mut work = [0.0; 7];
    for shown in pixels {
        let known = if sum(&shown.profiled) > 0.0 { &shown.profiled } else { &all };
        let sum = sum(known);
        if sum > 0.0 {
            work.iter_mut().zip(known.by_ray).for_each(|(work, of_ray)| *work += shown.work * (of_ray / sum));
        }
    }
    (sum(&all) > 0.0).then_some(work)
}

/// Work of the pixels that does not grow with the camera samples, by the same proportions.
pub(super) fn extra_work(pixels: &[ShownWork]) -> f64 {
    let all = all_profiled(pixels);
    let of = |shown: &ShownWork| {
        let known = if shown.profiled.work > 0.0 { &shown.profiled } else { &all };
        if known.work > 0.0 { shown.work * (known.extra / known.work) } else { 0.0 }
    };
    pixels.iter().map(of).sum()
}

fn all_profiled(pixels: &[ShownWork]) -> ProfiledWork {
    pixels.iter().map(|shown| shown.profiled).fold(ProfiledWork::default(), ProfiledWork::plus)
}
