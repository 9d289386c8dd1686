//! Renders one part of a divided frame.

use super::checkpoint::Checkpoints;
use super::given::{self, own, usable};
use super::progress::{count, fraction};
use crate::answers::Progress;
use crate::frame::OwnFrame;
use crate::shot::OwnShot;
use forelight_forecast::PixelCurve;
use forelight_protocol::{
    FinishedPart, LogLevel, PartPixels, PartRange, PixelRange, RenderPartResult, RenderPartSpec,
    RenderSettings, Spent, TaskResult,
};
use forelight_renderer::{Assignment, Control, ExecuteError, Files, Outcome};
use forelight_tracer::{Pixel, Totals, clocked};
use std::sync::Once;

/// `loading` is the cost of opening the scene, if it was not open yet.
pub(crate) fn render_part(
    shot: &OwnShot,
    spec: &RenderPartSpec,
    loading: Spent,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let settings = own(&spec.settings)?;
    let range = range(spec, settings)?;
    let ready = shot.frame(spec.frame, settings)?;
    let start = given::start(&ready, (spec.cache, spec.frame_cache), assignment, control)?;
    let curve = PixelCurve::new(settings.width, settings.height);
    let pixels = pixels(&ready, curve.pixels(range.from..range.to), &start, assignment, control)?;
    let Totals { pixels: number, work, cpu_nanos, .. } = Totals::of(pixels.iter().map(|(_, pixel)| pixel));
    let cost = Spent { work, cpu_nanos };
    control.log(
        LogLevel::Info,
        format!("part {} of {}: {number} pixels, {work} units of work", spec.part + 1, spec.parts),
    );
    let (bytes, writing) = clocked(|| ready.finished_pixels(pixels).to_bytes());
    let here = loading.plus(ready.spent_on_setup()).plus(ready.spent_on_cache_here(start.on_cache));
    let mut files = Files::default();
    // At most as many pixels as an image has.
    let finished = PartPixels { hash: files.add(bytes), count: number as u32, cost };
    let result = RenderPartResult {
        finished: FinishedPart::Pixels(finished),
        spent: cost.plus(here).plus(Spent { work: 0, cpu_nanos: writing }),
        peak_memory_bytes: forelight_renderer::peak_rss_bytes(),
    };
    Ok(Outcome { result: TaskResult::RenderPart(result), artifacts: files.contents })
}

/// The part's range of the image's pixels.
fn range(spec: &RenderPartSpec, settings: &RenderSettings) -> Result<PixelRange, ExecuteError> {
    match spec.range {
        Some(PartRange::Pixels(range))
            if range.from <= range.to && u64::from(range.to) <= settings.pixels() =>
        {
            Ok(range)
        }
        Some(range) => {
            let text = format!("an image of {} pixels has no part {range:?}", settings.pixels());
            Err(ExecuteError::Permanent(text))
        }
        None => Err(ExecuteError::Transient("the frame is not divided yet".to_owned())),
    }
}

/// The pixels of the part, less those of the frame's profile. Those that an earlier worker finished are not
/// traced again.
fn pixels(
    ready: &OwnFrame<'_>,
    mut part: Vec<u32>,
    start: &given::Start,
    assignment: &Assignment,
    control: &Control,
) -> Result<Vec<(u32, Pixel)>, ExecuteError> {
    let mut profiled = vec![false; ready.frame().camera.pixels()];
    if let Some(profile) = &start.profile {
        profile.pixels.iter().for_each(|(index, _)| profiled[*index as usize] = true);
    }
    part.retain(|&index| !profiled[index as usize]);
    let mut is_open = vec![false; profiled.len()];
    part.iter().for_each(|&index| is_open[index as usize] = true);
    let checkpoint = assignment.checkpoint.as_ref();
    let checkpoint = checkpoint.and_then(|bytes| usable("an earlier worker's pixels", bytes, ready, control));
    let mut finished = checkpoint.map_or_else(Vec::new, |checkpoint| checkpoint.pixels);
    finished.retain(|(index, _)| std::mem::take(&mut is_open[*index as usize]));
    let open: Vec<u32> = part.iter().copied().filter(|&index| is_open[index as usize]).collect();
    let all = part.len() as u64;
    if !finished.is_empty() {
        let text = format!("continuing from {} pixels that an earlier worker finished", finished.len());
        control.log(LogLevel::Info, text);
    }
    count(&finished, all, control);
    let checkpoints = Checkpoints::new(control, Some(ready.finished_pixels(finished.clone())), all);
    let fills = !ready.has_final_colours();
    let begun = Once::new();
    let watch = |pixels: &[_]| {
        begun.call_once(|| control.spent_before_pixels(ready.spent_on_cache_here(start.on_cache)));
        count(pixels, all, control);
        checkpoints.finished(pixels);
    };
    let progress = |progress: Progress| control.set_progress(fraction(progress, fills));
    let traced = ready.render_pixels(&open, &progress, &watch, control.cancelled());
    finished.extend(traced.ok_or(ExecuteError::Cancelled)?);
    finished.sort_unstable_by_key(|(index, _)| *index);
    Ok(finished)
}
