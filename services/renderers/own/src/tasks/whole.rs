//! Puts a divided frame together from the files of its parts.

use super::given::{self, usable};
use super::progress::{count, fraction};
use crate::answers::Progress;
use crate::frame::OwnFrame;
use crate::render::{Rendered, rendered};
use forelight_protocol::{RenderSettings, RenderSpec};
use forelight_renderer::{Assignment, Control, ExecuteError};
use forelight_tracer::Pixel;
use std::time::Instant;

/// Takes over the pixels of all parts and of the frame's profile. Pixels that none of them holds are traced.
pub(crate) fn put_together(
    ready: &OwnFrame<'_>,
    settings: &RenderSettings,
    spec: &RenderSpec,
    assignment: &Assignment,
    control: &Control,
) -> Result<Rendered, ExecuteError> {
    let start = Instant::now();
    let caches = (spec.cache, spec.frame_cache);
    let given::Start { profile, .. } = given::start(ready, caches, assignment, control)?;
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
    let progress = |progress: Progress| control.set_progress(fraction(progress, false));
    let made = ready.put_together(finished, profile.as_ref(), &progress, &watch, control.cancelled())?;
    let made = made.ok_or(ExecuteError::Cancelled)?;
    Ok(rendered(ready, made, settings, start.elapsed().as_secs_f64()))
}
