//! A render that spends a given amount of work.
//!
//! The same work gives a smaller error where pixels vary. So the frame is rendered in passes:
//!
//! 1. One sample for every pixel, which shows the cost of a sample.
//! 2. An eighth of the work, spread evenly: at least two samples for every pixel, if there is work for them.
//! 3. Further passes where samples pay ([`crate::adaptive::tiles`]), each at most doubling the work.
//!
//! There is no clock, unlike in [`crate::adaptive::time_limit`]: the image depends on the work alone.

use crate::adaptive::error_target::pass;
use crate::adaptive::made::Made;
use crate::adaptive::tiles::Tiles;
use crate::answers::Progress;
use crate::error::{RenderError, ShotError};
use crate::frame::OwnFrame;
use forelight_forecast::accuracy::Survey;
use forelight_forecast::accuracy::allot::even_numbers;
use forelight_tracer::{Passes, SampleCounts, Totals};
use std::sync::atomic::{AtomicBool, Ordering};

/// Share of the work that is spread evenly, for features that the first samples of a tile miss.
const EVEN: f64 = 0.125;
/// Samples per pixel that show whether it varies.
const TELLING: f64 = 2.0;
/// A pass multiplies the work spent by at most this.
const GROWTH: f64 = 2.0;
/// Share of the work that may be left over: whole samples do not come out even.
const NEAR: f64 = 0.005;

/// How an amount of work is spent on a frame, pass by pass. Each pass depends on the image so far, and not on
/// who traced it: the nodes of a farm may share the pixels of every pass.
pub(crate) struct WorkBudget {
    tiles: Tiles,
    pixels: usize,
    /// Work that is left for pixels.
    all: f64,
}

/// A pass to come.
pub(crate) struct NextPass {
    /// Samples of each pixel after it.
    pub samples: SampleCounts,
    /// Share of the pixels' work that is done after it, at most about 1.
    pub until: f64,
}

/// The image after a pass.
pub(crate) struct Standing {
    pub samples: SampleCounts,
    pub survey: Survey,
    /// Share of the pixels' work that is done, at most 1.
    pub done: f64,
    /// `None`: the image is finished.
    pub next: Option<NextPass>,
}

impl WorkBudget {
    /// For a frame, whose cache is filled, that gets `work` in all.
    pub fn new(ready: &OwnFrame<'_>, work: u64) -> Self {
        let camera = &ready.frame().camera;
        Self {
            tiles: Tiles::unprofiled(camera.width, camera.height),
            pixels: camera.pixels(),
            all: work.saturating_sub(before_pixels(ready)).max(1) as f64,
        }
    }

    /// The first pass: one sample for every pixel.
    pub fn first(&self) -> Result<NextPass, RenderError> {
        Ok(NextPass { samples: self.everywhere(1)?, until: 0.0 })
    }

    fn everywhere(&self, samples: u32) -> Result<SampleCounts, RenderError> {
        Ok(SampleCounts::new(vec![samples as u16; self.pixels])?)
    }

    /// What the image shows after a pass. Every pixel must have a sample.
    pub fn evaluate(&self, passes: &Passes) -> Result<Standing, ShotError> {
        let samples = passes.counts().map_err(RenderError::from)?;
        let survey = self.tiles.survey(passes)?;
        let done = (passes.totals().work as f64).max(1.0);
        let next = self.after(&samples, &survey, done)?;
        Ok(Standing { samples, survey, done: (done / self.all).min(1.0), next })
    }

    fn after(&self, has: &SampleCounts, survey: &Survey, done: f64) -> Result<Option<NextPass>, RenderError> {
        let all = self.all;
        if all - done < NEAR * all {
            return Ok(None);
        }
        let is_first = has.range().1 == 1;
        let [even, _] = even_numbers(if is_first { (EVEN * all / done).max(TELLING) } else { 1.0 });
        let with_even = f64::from(even) * done;
        let (samples, then) = if even < 2 || with_even > all {
            let then = all.min(GROWTH * done);
            let Some(samples) = survey.samples_for_budget(then) else { return Ok(None) };
            (self.tiles.laid_out(&samples)?.or_more(has), then)
        } else {
            (self.everywhere(even)?, with_even)
        };
        // If nothing is added, nothing varies, or no whole sample is left.
        Ok((samples != *has).then_some(NextPass { samples, until: then / all }))
    }
}

/// Renders a frame, whose cache is filled, with `work` in all, but at least one sample per pixel. `passed`
/// gets the work of the pixels so far and its share of their budget. `None` if `cancel` was set.
pub(crate) fn render_for_work(
    ready: &OwnFrame<'_>,
    work: u64,
    progress: &(dyn Fn(Progress) + Sync),
    passed: &dyn Fn(f64, &Totals),
    cancel: &AtomicBool,
) -> Result<Option<Made>, ShotError> {
    let budget = WorkBudget::new(ready, work);
    let mut passes = ready.begin();
    let mut next = budget.first()?;
    let mut done = 0.0;
    loop {
        pass(ready, &mut passes, &next.samples, &(done..next.until), progress, cancel)?;
        if cancel.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let standing = budget.evaluate(&passes)?;
        done = standing.done;
        passed(done, &passes.totals());
        match standing.next {
            Some(pass) => next = pass,
            None => return Ok(Some(standing.made(ready, &passes))),
        }
    }
}

impl Standing {
    /// The finished image.
    pub fn made(self, ready: &OwnFrame<'_>, passes: &Passes) -> Made {
        let Self { samples, survey, .. } = self;
        Made { finished: ready.finished(passes), samples, survey, within: None }
    }
}

fn before_pixels(ready: &OwnFrame<'_>) -> u64 {
    let fixed = ready.fixed();
    let fill = ready.spent_on_cache().work.saturating_sub(fixed.plan.work);
    fixed.total().work.saturating_add(fill)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::Converged;
    use crate::common::{Nobody, kitchen};
    use crate::render::Rendered;
    use crate::{Given, render_frame};
    use forelight_protocol::{CacheMode, RenderSettings, RenderSettingsRequest};

    fn settings(size: (u32, u32), spp: u32, cache: CacheMode) -> RenderSettings {
        let request = RenderSettingsRequest {
            spp: Some(spp),
            ambient_bounces: Some(u32::from(cache == CacheMode::On)),
            cache: Some(cache),
            cache_rays: Some(48),
            ..RenderSettingsRequest::default()
        };
        request.complete(size)
    }

    fn even(settings: &RenderSettings) -> Rendered {
        let (given, never) = (Given::default(), AtomicBool::new(false));
        render_frame(&kitchen(), 0, settings, given, &|_| (), &never).unwrap().unwrap()
    }

    fn spent(settings: &RenderSettings, work: u64) -> Rendered {
        let (shot, never) = (kitchen(), AtomicBool::new(false));
        let ready = shot.frame(0, settings).unwrap();
        assert!(ready.fill(&|_| (), &never));
        let made = render_for_work(&ready, work, &|_| (), &|_, _| (), &never).unwrap().unwrap();
        made.rendered(&ready, settings, None, 0.0).rendered
    }

    #[test]
    fn the_same_work_makes_less_error_where_it_goes_to_what_varies() {
        for cache in [CacheMode::Off, CacheMode::On] {
            let settings = settings((64, 36), 16, cache);
            let many = RenderSettings { spp: 256, ..settings.clone() };
            let truth = Converged::new(&kitchen(), 0, many, &Nobody::default()).unwrap();
            let uniform = even(&settings);
            let made = spent(&settings, uniform.stats.work);
            let share = made.stats.work as f64 / uniform.stats.work as f64;
            assert!((share - 1.0).abs() < 0.01, "{share} of the work");
            let [made_error, uniform_error] = [&made, &uniform].map(|each| truth.error(&each.image).0);
            let allotted = made.stats.allotted.unwrap();
            assert!(made_error < 0.95 * uniform_error, "{made_error} is not below {uniform_error}");
            assert!((allotted.error.p50 / made_error - 1.0).abs() < 0.5, "{allotted:?}, made {made_error}");
        }
    }

    #[test]
    fn too_little_work_is_one_sample_a_pixel_and_more_than_there_is_use_for_comes_to_an_end() {
        for (size, work) in [((8, 5), 0), ((8, 5), 1), ((1, 1), u64::MAX), ((3, 1), 100_000_000)] {
            let made = spent(&settings(size, 1, CacheMode::Off), work);
            let allotted = made.stats.allotted.unwrap();
            assert!(work > 1 || allotted.most == 1, "{allotted:?}");
            assert!(allotted.most <= 65_535 && allotted.error.p95.is_finite(), "{allotted:?}");
        }
    }
}
