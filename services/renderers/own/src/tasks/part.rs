//! Renders one part of a divided frame.

use super::checkpoint::Checkpoints;
use super::given::{self, own, usable};
use super::pass::pass;
use super::progress::{count, fraction};
use crate::answers::Progress;
use crate::frame::OwnFrame;
use crate::shot::OwnShot;
use forelight_forecast::Stretch;
use forelight_protocol::{
    FinishedPart, LogLevel, PartPixels, PartRange, PixelRange, RenderPartResult, RenderPartSpec,
    RenderSettings, RestOfPart, Spent, TaskResult,
};
use forelight_renderer::{Assignment, Control, ExecuteError, Files, Outcome};
use forelight_tracer::{Pixel, Profile, Totals, clocked};
use std::sync::Once;

/// What a part has made.
pub(super) struct Made {
    pub file: Vec<u8>,
    /// Number of pixels, less those that are left to others.
    pub count: u64,
    /// Of the pixels, or of what a pass has added to them.
    pub cost: Spent,
    /// CPU time of writing the file, in nanoseconds.
    pub writing: u64,
    /// What is left to others, and the cost of dividing it.
    pub rest: Option<(RestOfPart, Spent)>,
}

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
    let pixels = ready.curve().pixels(range.from..range.to);
    let made = match spec.pass {
        None => finished(&ready, (range, pixels), &start, assignment, control)?,
        Some(_) => pass(&ready, (range, &pixels), start.on_cache, assignment, control)?,
    };
    let Made { file, count, cost, writing, rest } = made;
    let (part, parts) = (spec.part + 1, spec.parts);
    control
        .log(LogLevel::Info, format!("part {part} of {parts}: {count} pixels, {} units of work", cost.work));
    let here = loading.plus(ready.spent_on_setup()).plus(ready.spent_on_cache_here(start.on_cache));
    let mut files = Files::default();
    // At most as many pixels as an image has.
    let finished = PartPixels { hash: files.add(file), count: count as u32, cost };
    let (rest, dividing) = rest.map_or((None, Spent::default()), |(rest, spent)| (Some(rest), spent));
    let result = RenderPartResult {
        finished: FinishedPart::Pixels(finished),
        rest,
        spent: cost.plus(here).plus(dividing).plus(Spent { work: 0, cpu_nanos: writing }),
        peak_memory_bytes: forelight_renderer::peak_rss_bytes(),
    };
    Ok(Outcome { result: TaskResult::RenderPart(result), artifacts: files.contents })
}

/// Renders the part's pixels, or as many as are begun when the rest is to be left to others.
fn finished(
    ready: &OwnFrame<'_>,
    (range, part): (PixelRange, Vec<u32>),
    start: &given::Start,
    assignment: &Assignment,
    control: &Control,
) -> Result<Made, ExecuteError> {
    let mut pixels = pixels(ready, part.clone(), start, assignment, control)?;
    let left = left(ready, &part, &pixels, start);
    if let Some(done) = left {
        // What an earlier worker finished behind the first gap is left as well.
        let mut is_left = vec![false; ready.frame().camera.pixels()];
        part[done..].iter().for_each(|&index| is_left[index as usize] = true);
        pixels.retain(|(index, _)| !is_left[*index as usize]);
    }
    let Totals { pixels: count, work, cpu_nanos, .. } = Totals::of(pixels.iter().map(|(_, pixel)| pixel));
    let divide = |done| {
        // A part has at most as many pixels as an image.
        let first = range.from + done as u32;
        let parts = control.rest_in_parts().unwrap_or(1);
        let divided = ready.divide_places(first..range.to, parts, &|| control.is_cancelled());
        let divided = divided.ok_or(ExecuteError::Cancelled)?;
        Ok::<_, ExecuteError>((left_to_others(first, work, &divided.parts, control), divided.spent))
    };
    let rest = left.map(divide).transpose()?;
    let (file, writing) = clocked(|| ready.finished_pixels(pixels).to_bytes());
    Ok(Made { file, count, cost: Spent { work, cpu_nanos }, writing, rest })
}

/// How many pixels of a part are known before the first that is not. `None` if all are.
fn left(
    ready: &OwnFrame<'_>,
    part: &[u32],
    finished: &[(u32, Pixel)],
    start: &given::Start,
) -> Option<usize> {
    let profiled = start.profile.iter().flat_map(|profile| &profile.pixels);
    let mut is_known = vec![false; ready.frame().camera.pixels()];
    finished.iter().chain(profiled).for_each(|(index, _)| is_known[*index as usize] = true);
    part.iter().position(|&index| !is_known[index as usize])
}

/// What is left of a part of which `work` is done: pieces from the place `first` on.
pub(super) fn left_to_others(first: u32, work: u64, pieces: &[Stretch], control: &Control) -> RestOfPart {
    let text = format!("the rest of the part is left to others, in {} parts", pieces.len());
    control.log(LogLevel::Info, text);
    let ends = std::iter::once(first).chain(pieces.iter().map(|piece| piece.to)).collect();
    let work = std::iter::once(work).chain(pieces.iter().map(|piece| piece.cost)).collect();
    RestOfPart { ends, work }
}

/// The part's range of the image's pixels.
fn range(spec: &RenderPartSpec, settings: &RenderSettings) -> Result<PixelRange, ExecuteError> {
    match spec.assigned_range() {
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
    let checkpoints =
        Checkpoints::new(control, Some(ready.finished_pixels(finished.clone())), Profile::bytes_of(all));
    let fills = !ready.has_final_colours();
    let begun = Once::new();
    let watch = |pixels: &[_]| {
        begun.call_once(|| control.spent_before_pixels(ready.spent_on_cache_here(start.on_cache)));
        count(pixels, all, control);
        checkpoints.finished(pixels);
    };
    let progress = |progress: Progress| control.set_progress(fraction(progress, fills));
    let enough = || control.rest_in_parts().is_some();
    let traced = ready.render_pixels(&open, &enough, &progress, &watch, control.cancelled());
    finished.extend(traced.ok_or(ExecuteError::Cancelled)?);
    finished.sort_unstable_by_key(|(index, _)| *index);
    Ok(finished)
}
