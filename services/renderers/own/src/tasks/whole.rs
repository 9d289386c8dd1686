//! Puts a divided frame together from the files of its parts.

use super::given::{take_over, usable};
use super::progress::{count, fraction};
use crate::adaptive::made::Made;
use crate::adaptive::passes::PassPlan;
use crate::answers::Progress;
use crate::frame::OwnFrame;
use crate::render::{Rendered, rendered};
use forelight_protocol::{self as protocol, FinishedPixels, LogLevel, RenderSettings};
use forelight_renderer::{Assignment, Control, ExecuteError};
use forelight_tracer::{Pixel, Profile};
use std::time::Instant;

/// Takes over the pixels of all parts and of the frame's profile. Pixels that none of them holds are traced. This is
/// a `share` of the task's progress.
pub(crate) fn put_together(
    ready: &OwnFrame<'_>,
    settings: &RenderSettings,
    (profile, share): (Option<Profile>, f64),
    assignment: &Assignment,
    control: &Control,
) -> Result<Rendered, ExecuteError> {
    let start = Instant::now();
    let all = settings.pixels();
    let mut finished: Vec<Option<Pixel>> = vec![None; ready.frame().camera.pixels()];
    for (bytes, part) in assignment.parts.iter().zip(1..) {
        if control.is_cancelled() {
            return Err(ExecuteError::Cancelled);
        }
        let what = format!("the file of part {part}");
        let Some(part) = usable(&what, bytes, ready, control) else { continue };
        count(&part.pixels, all, control);
        part.pixels.into_iter().for_each(|(index, pixel)| finished[index as usize] = Some(pixel));
    }
    if let Some(profile) = &profile {
        count(&profile.pixels, all, control);
    }
    let watch = |pixels: &[_]| count(pixels, all, control);
    let progress = |progress: Progress| control.set_progress(share * fraction(progress, false));
    let made = ready.put_together(finished, profile.as_ref(), &progress, &watch, control.cancelled())?;
    let made = made.ok_or(ExecuteError::Cancelled)?;
    Ok(rendered(ready, made, settings, start.elapsed().as_secs_f64()))
}

/// Takes over the samples of all passes. `None` if they cannot be read, as those of another version of the
/// renderer: the frame is rendered anew then.
pub(crate) fn passes_put_together(
    ready: &OwnFrame<'_>,
    plan: &protocol::Passes,
    assignment: &Assignment,
    control: &Control,
) -> Result<Option<Made>, ExecuteError> {
    let mut passes = ready.begin();
    match take_over(&mut passes, ready, assignment, control) {
        Ok(()) => {}
        Err(ExecuteError::Cancelled) => return Err(ExecuteError::Cancelled),
        Err(error) => {
            control.log(LogLevel::Warn, format!("the frame is rendered again in one piece: {error}"));
            return Ok(None);
        }
    }
    let (all, totals) = (ready.frame().camera.pixels() as u64, passes.totals());
    control.finished_pixels(FinishedPixels {
        done: all,
        all,
        work: totals.work,
        cpu_nanos: totals.cpu_nanos,
    });
    Ok(Some(PassPlan::of(ready, plan)?.evaluate(&passes)?.made(ready, &passes)))
}
