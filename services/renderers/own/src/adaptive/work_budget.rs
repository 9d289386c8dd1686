//! Passes until an amount of work is spent.
//!
//! The same work gives a smaller error where pixels vary. So the frame is rendered in passes:
//!
//! 1. One sample for every pixel, which shows the cost of a sample.
//! 2. An eighth of the work, spread evenly: at least two samples for every pixel, if there is work for them.
//! 3. Further passes where samples pay ([`crate::adaptive::tiles`]), each at most doubling the work.

use crate::adaptive::passes::{Following, NextPass};
use crate::adaptive::tiles::Tiles;
use crate::error::RenderError;
use crate::frame::OwnFrame;
use forelight_forecast::accuracy::Survey;
use forelight_forecast::accuracy::allot::even_numbers;
use forelight_tracer::SampleCounts;

/// Share of the work that is spread evenly, for features that the first samples of a tile miss.
const EVEN: f64 = 0.125;
/// Samples per pixel that show whether it varies.
const TELLING: f64 = 2.0;
/// A pass multiplies the work spent by at most this.
const GROWTH: f64 = 2.0;
/// Share of the work that may be left over: whole samples do not come out even.
const NEAR: f64 = 0.005;

/// How much work the pixels of a frame get.
pub(crate) struct WorkBudget(f64);

impl WorkBudget {
    /// Samples of every pixel in the first pass.
    pub const FIRST: u16 = 1;

    /// For a frame, whose cache is filled, that gets `work` in all.
    pub fn new(ready: &OwnFrame<'_>, work: u64) -> Self {
        Self(work.saturating_sub(before_pixels(ready)).max(1) as f64)
    }

    /// What follows a pass with these samples, which took `done` work.
    pub fn after(
        &self,
        tiles: &Tiles,
        has: &SampleCounts,
        survey: &Survey,
        done: u64,
    ) -> Result<Following, RenderError> {
        let (all, done) = (self.0, (done as f64).max(1.0));
        let following = |next| Ok(Following { done: done / all, next });
        if all - done < NEAR * all {
            return following(None);
        }
        let is_first = has.range().1 == u32::from(Self::FIRST);
        let [even, _] = even_numbers(if is_first { (EVEN * all / done).max(TELLING) } else { 1.0 });
        let with_even = f64::from(even) * done;
        let (samples, then) = if even < 2 || with_even > all {
            let then = all.min(GROWTH * done);
            let Some(samples) = survey.samples_for_budget(then) else { return following(None) };
            (tiles.laid_out(&samples)?.or_more(has), then)
        } else {
            (SampleCounts::new(vec![even as u16; has.as_slice().len()])?, with_even)
        };
        // If nothing is added, nothing varies, or no whole sample is left.
        following((samples != *has).then_some(NextPass { samples, until: then / all }))
    }
}

fn before_pixels(ready: &OwnFrame<'_>) -> u64 {
    let fixed = ready.fixed();
    let fill = ready.spent_on_cache().work.saturating_sub(fixed.plan.work);
    fixed.total().work.saturating_add(fill)
}

#[cfg(test)]
mod tests {
    use crate::accuracy::Converged;
    use crate::adaptive::passes::{PassPlan, render_in_passes};
    use crate::common::{Nobody, kitchen};
    use crate::render::Rendered;
    use crate::{Given, render_frame};
    use forelight_protocol::{CacheMode, RenderSettings, RenderSettingsRequest};
    use std::sync::atomic::AtomicBool;

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
        let plan = PassPlan::for_work(&ready, work).unwrap();
        let made = render_in_passes(&ready, &plan, &|_| (), &|_, _| (), &never).unwrap().unwrap();
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
