//! Finds where the parts of a frame end, and plans its irradiance cache. A frame that is rendered in passes
//! is divided before each of them.

use super::given;
use crate::adaptive::passes::PassPlan;
use crate::division::Divided;
use crate::division::passes::picture;
use crate::frame::OwnFrame;
use crate::shot::OwnShot;
use forelight_forecast::Stretch;
use forelight_pictures::png;
use forelight_protocol::{
    CACHE_BYTES, DivideResult, DivideSpec, FrameCache, LogLevel, MOST_PARTS, Passes, Spent, TaskResult,
};
use forelight_renderer::{Assignment, Control, ExecuteError, Files, Outcome};
use forelight_tracer::{Cache, Profile, SampleCounts, clocked};
use image::RgbImage;

/// A frame, divided.
struct Division {
    /// Empty if nothing is left to render.
    parts: Vec<Stretch>,
    /// What each pixel has after the next pass.
    samples: Option<SampleCounts>,
    picture: RgbImage,
    /// Of all pixels, by the image so far, if the frame is rendered for an error.
    expected_work: Option<u64>,
    /// Cost of dividing.
    spent: Spent,
}

/// `loading` is the cost of opening the scene, if it was not open yet.
pub(crate) fn divide(
    shot: &OwnShot,
    spec: &DivideSpec,
    loading: Spent,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    if !(1..=MOST_PARTS).contains(&spec.parts) {
        let text = format!("cannot divide a frame into {} parts, only into 1 to {MOST_PARTS}", spec.parts);
        return Err(ExecuteError::Permanent(text));
    }
    let ready = shot.frame(spec.frame, &spec.settings)?;
    let caches = (spec.cache, spec.frame_cache);
    let given::Start { profile, on_cache } = given::start(&ready, caches, assignment, control)?;
    let mut files = Files::default();
    let is_first = spec.passes.as_ref().is_none_or(|passes| passes.before.is_empty());
    let (cache, writing) = match (spec.frame_cache, assignment.caches.last()) {
        (Some(hash), Some(cache)) => (Some(FrameCache { hash, bytes: cache.len() as u64, full: true }), 0),
        _ => frame_cache(&ready, &mut files)?,
    };
    control.set_progress(0.5);
    let divided = match &spec.passes {
        Some(passes) if !is_first => next_pass(&ready, spec, passes, assignment, control),
        passes => first(&ready, spec.parts, passes.as_ref(), profile, control),
    };
    let Division { parts, samples, picture, expected_work, spent } = divided?;
    let work: u64 = parts.iter().map(|part| part.cost).sum();
    let text = match parts.len() {
        0 => format!("frame {} has all its samples", spec.frame),
        count => format!("divided frame {} into {count} parts: {work} units of work in all", spec.frame),
    };
    control.log(LogLevel::Info, text);
    let (coarse, drawing) = clocked(|| png(&picture));
    let spent = spent.plus(loading).plus(ready.spent_on_setup()).plus(ready.spent_on_cache_here(on_cache));
    let result = DivideResult {
        ends: parts.iter().map(|part| part.to).collect(),
        work: parts.iter().map(|part| part.cost).collect(),
        cache,
        // Nothing but a picture to look at would be missing.
        coarse_png: coarse.ok().map(|bytes| files.add(bytes)),
        samples: samples.map(|samples| files.add(samples.to_bytes())),
        expected_work,
        spent: Spent { cpu_nanos: spent.cpu_nanos + writing + drawing, ..spent },
    };
    Ok(Outcome { result: TaskResult::Divide(result), artifacts: files.contents })
}

/// Divides a frame of which nothing is rendered, for its first pass if it has passes.
fn first(
    ready: &OwnFrame<'_>,
    parts: u32,
    passes: Option<&Passes>,
    profile: Option<Profile>,
    control: &Control,
) -> Result<Division, ExecuteError> {
    let finished = profile.map_or_else(Vec::new, |profile| profile.pixels);
    let stop = || control.is_cancelled();
    let (divided, samples) = match passes {
        None => (ready.divide(parts, &finished, &stop), None),
        Some(passes) => {
            let plan = PassPlan::of(ready, passes)?;
            let samples = plan.first();
            // The first pass gives every pixel as many.
            (ready.divide_first_pass(samples.range().1, parts, &stop), Some(samples.clone()))
        }
    };
    let Divided { parts, seen, spent } = divided.ok_or(ExecuteError::Cancelled)?;
    let picture = ready.coarse_picture(&seen, &finished);
    Ok(Division { parts, samples, picture, expected_work: None, spent })
}

/// Divides the pass that follows the one whose pixels are given.
fn next_pass(
    ready: &OwnFrame<'_>,
    spec: &DivideSpec,
    plan: &Passes,
    assignment: &Assignment,
    control: &Control,
) -> Result<Division, ExecuteError> {
    let (divided, cpu_nanos) = clocked(|| {
        let mut passes = ready.begin();
        given::take_over(&mut passes, ready, assignment, control)?;
        let standing = PassPlan::of(ready, plan)?.evaluate(&passes)?;
        let expected = plan.error_target.map(|_| standing.expected_work(passes.totals().work));
        let next = standing.next.map(|pass| pass.samples);
        let parts = next
            .as_ref()
            .map_or_else(Vec::new, |next| ready.divide_pass(&passes, next, ready.places(), spec.parts));
        Ok::<_, ExecuteError>((parts, next, picture(&passes), expected))
    });
    let (parts, samples, picture, expected_work) = divided?;
    let spent = Spent { work: 0, cpu_nanos };
    Ok(Division { parts, samples, picture, expected_work, spent })
}

/// The irradiance cache that parts need beside a shared one, and the CPU time of writing it, in nanoseconds.
fn frame_cache(ready: &OwnFrame<'_>, files: &mut Files) -> Result<(Option<FrameCache>, u64), ExecuteError> {
    let Some(cache) = ready.cache_for_parts() else { return Ok((None, 0)) };
    cache.smooth_full();
    let (bytes, writing) = clocked(|| Cache::to_bytes(cache));
    let size = bytes.len() as u64;
    if size > CACHE_BYTES {
        let text = format!("the frame's irradiance cache has {size} bytes: render the frame in one piece");
        return Err(ExecuteError::Permanent(text));
    }
    let full = cache.is_complete();
    Ok((Some(FrameCache { hash: files.add(bytes), bytes: size, full }), writing))
}
