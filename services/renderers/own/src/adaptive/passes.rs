//! A frame in passes: each shows where the samples of the next one lower the error most.
//!
//! A pass depends on the image so far, and not on who traced it: the nodes of a farm may share its pixels. The
//! image depends on the aim alone. Only a time limit needs a clock: [`crate::adaptive::time_limit`].

use crate::adaptive::error_target::ErrorAim;
use crate::adaptive::made::Made;
use crate::adaptive::tiles::Tiles;
use crate::adaptive::work_budget::WorkBudget;
use crate::answers::{Progress, Step};
use crate::error::{RenderError, ShotError};
use crate::frame::OwnFrame;
use forelight_forecast::accuracy::Survey;
use forelight_protocol as protocol;
use forelight_tracer::{Passes, SampleCounts, Totals};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// How a frame is rendered in passes.
pub(crate) struct PassPlan {
    tiles: Tiles,
    aim: Aim,
    first: SampleCounts,
}

enum Aim {
    Work(WorkBudget),
    Error(ErrorAim),
}

/// A pass to come.
pub(crate) struct NextPass {
    /// Samples of each pixel after it.
    pub samples: SampleCounts,
    /// Share of the pixels' work that is done after it, at most about 1.
    pub until: f64,
}

/// What follows a pass.
pub(crate) struct Following {
    /// Share of the pixels' work that is done.
    pub done: f64,
    /// `None`: the image is finished.
    pub next: Option<NextPass>,
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

impl PassPlan {
    /// As the tasks of a divided frame say.
    pub fn of(ready: &OwnFrame<'_>, passes: &protocol::Passes) -> Result<Self, RenderError> {
        match passes.error_target {
            Some(target) => {
                let aim = ErrorAim { wanted: target.share(), confidence: target.confidence };
                Self::for_error(ready, aim)
            }
            None => Self::for_work(ready, passes.work),
        }
    }

    /// For a frame, whose cache is filled, that gets `work` in all, but at least one sample per pixel.
    pub fn for_work(ready: &OwnFrame<'_>, work: u64) -> Result<Self, RenderError> {
        let budget = WorkBudget::new(ready, work);
        Ok(Self {
            tiles: unprofiled(ready),
            first: everywhere(ready, WorkBudget::FIRST)?,
            aim: Aim::Work(budget),
        })
    }

    /// For a frame that is rendered until its error is small enough.
    pub fn for_error(ready: &OwnFrame<'_>, aim: ErrorAim) -> Result<Self, RenderError> {
        let first = everywhere(ready, ErrorAim::FIRST)?;
        Ok(Self { tiles: unprofiled(ready), first, aim: Aim::Error(aim) })
    }

    /// Samples of each pixel after the first pass.
    pub fn first(&self) -> &SampleCounts {
        &self.first
    }

    /// What the image shows after a pass. Every pixel must have a sample.
    pub fn evaluate(&self, passes: &Passes) -> Result<Standing, ShotError> {
        let samples = passes.counts().map_err(RenderError::from)?;
        let survey = self.tiles.survey(passes)?;
        let Following { done, next } = match &self.aim {
            Aim::Work(budget) => budget.after(&self.tiles, &samples, &survey, passes.totals().work)?,
            Aim::Error(aim) => aim.after(&self.tiles, &samples, &survey)?,
        };
        Ok(Standing { samples, survey, done: done.min(1.0), next })
    }
}

fn unprofiled(ready: &OwnFrame<'_>) -> Tiles {
    let camera = &ready.frame().camera;
    Tiles::unprofiled(camera.width, camera.height)
}

fn everywhere(ready: &OwnFrame<'_>, samples: u16) -> Result<SampleCounts, RenderError> {
    Ok(SampleCounts::new(vec![samples; ready.frame().camera.pixels()])?)
}

impl Standing {
    /// Work that the pixels, which took `work` so far, will probably take in all.
    pub fn expected_work(&self, work: u64) -> u64 {
        (work as f64 / self.done.max(1e-9)).ceil() as u64
    }

    /// The finished image.
    pub fn made(self, ready: &OwnFrame<'_>, passes: &Passes) -> Made {
        let Self { samples, survey, .. } = self;
        Made { finished: ready.finished(passes), samples, survey, within: None }
    }
}

/// Renders a frame, whose cache is filled, pass by pass. `passed` gets the share of the pixels' work that is
/// done, and their cost so far. `None` if `cancel` was set.
pub(crate) fn render_in_passes(
    ready: &OwnFrame<'_>,
    plan: &PassPlan,
    progress: &(dyn Fn(Progress) + Sync),
    passed: &dyn Fn(f64, &Totals),
    cancel: &AtomicBool,
) -> Result<Option<Made>, ShotError> {
    let mut passes = ready.begin();
    let mut next = NextPass { samples: plan.first().clone(), until: 0.0 };
    let mut done = 0.0f64;
    loop {
        pass(ready, &mut passes, &next.samples, &(done..next.until.max(done)), progress, cancel)?;
        if cancel.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let standing = plan.evaluate(&passes)?;
        // What an error needs may turn out to be more than it seemed.
        done = standing.done.max(done);
        passed(done, &passes.totals());
        match standing.next {
            Some(pass) => next = pass,
            None => return Ok(Some(standing.made(ready, &passes))),
        }
    }
}

/// Brings the pixels to these numbers of samples. Progress goes from `shown.start` to `shown.end`.
fn pass(
    ready: &OwnFrame<'_>,
    passes: &mut Passes,
    wanted: &SampleCounts,
    shown: &Range<f64>,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<(), RenderError> {
    let (pixels, parts) = (wanted.as_slice().len() as u64, passes.parts() as f64);
    let told = AtomicU64::new(0);
    let show = || {
        let part = ((told.fetch_add(1, Ordering::Relaxed) + 1) as f64 / parts).min(1.0);
        let done = (pixels as f64 * (shown.start + part * (shown.end - shown.start))) as u64;
        progress(Progress { step: Step::Tracing, done, all: pixels });
    };
    ready.go_on(passes, wanted, &|| cancel.load(Ordering::Relaxed), &show)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::{Converged, direct_light};
    use crate::common::{Nobody, kitchen};
    use forelight_protocol::Confidence;

    #[test]
    fn images_have_the_error_that_is_asked_for() {
        let (shot, never) = (kitchen(), AtomicBool::new(false));
        let truth = Converged::new(&shot, 0, direct_light(256, 0), &Nobody::default()).unwrap();
        let aim = ErrorAim { wanted: 0.1, confidence: Confidence::P50 };
        let made = |seed| {
            let settings = direct_light(1, seed);
            let ready = shot.frame(0, &settings).unwrap();
            let plan = PassPlan::for_error(&ready, aim).unwrap();
            let made = render_in_passes(&ready, &plan, &|_| (), &|_, _| (), &never).unwrap().unwrap();
            let rendered = made.rendered(&ready, &settings, None, 0.0).rendered;
            let (made, told) = (truth.error(&rendered.image).0, rendered.stats.allotted.unwrap().error.p50);
            println!("seed {seed}: {made:.4}, by its own estimate {told:.4}");
            [made, told]
        };
        let all: Vec<[f64; 2]> = (1..5).map(made).collect();
        let [made, told] = [0, 1].map(|k| (all.iter().map(|of| of[k] * of[k]).sum::<f64>() / 4.0).sqrt());
        assert!((0.85..=1.05).contains(&(made / aim.wanted)), "{made} where {} was asked for", aim.wanted);
        assert!((made / told - 1.0).abs() < 0.1, "{made}, estimated {told}");
    }
}
