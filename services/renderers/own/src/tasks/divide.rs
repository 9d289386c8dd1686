//! Finds where the parts of a frame end, and plans its irradiance cache.

use super::given;
use crate::division::Divided;
use crate::frame::OwnFrame;
use crate::shot::OwnShot;
use forelight_pictures::png;
use forelight_protocol::{
    CACHE_BYTES, DivideResult, DivideSpec, FrameCache, LogLevel, MOST_PARTS, Spent, TaskResult,
};
use forelight_renderer::{Assignment, Control, ExecuteError, Files, Outcome};
use forelight_tracer::{Cache, clocked};

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
    let given::Start { profile, on_cache } = given::start(&ready, (spec.cache, None), assignment, control)?;
    let mut files = Files::default();
    let (cache, writing) = frame_cache(&ready, &mut files)?;
    control.set_progress(0.5);
    let finished = profile.map_or_else(Vec::new, |profile| profile.pixels);
    let stop = || control.is_cancelled();
    let Divided { parts, seen, spent } =
        ready.divide(spec.parts, &finished, &stop).ok_or(ExecuteError::Cancelled)?;
    let work: u64 = parts.iter().map(|part| part.cost).sum();
    control.log(
        LogLevel::Info,
        format!("divided frame {} into {} parts: {work} units of work in all", spec.frame, parts.len()),
    );
    let (coarse, drawing) = clocked(|| png(&ready.coarse_picture(&seen, &finished)));
    let spent = spent.plus(loading).plus(ready.spent_on_setup()).plus(ready.spent_on_cache_here(on_cache));
    let result = DivideResult {
        ends: parts.iter().map(|part| part.to).collect(),
        work: parts.iter().map(|part| part.cost).collect(),
        cache,
        // Nothing but a picture to look at would be missing.
        coarse_png: coarse.ok().map(|bytes| files.add(bytes)),
        spent: Spent { cpu_nanos: spent.cpu_nanos + writing + drawing, ..spent },
    };
    Ok(Outcome { result: TaskResult::Divide(result), artifacts: files.contents })
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
