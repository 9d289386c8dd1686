//! The task that renders a frame: with equally many camera samples for every pixel, or for a given amount of work.

use crate::adaptive::work_budget::render_for_work;
use crate::agent::checkpoint::Checkpoints;
use crate::agent::execute::{Assignment, Control, ExecuteError, Outcome};
use crate::render::pictures::{encode, write_cost};
use crate::render::{Rendered, render_ready, seconds};
use crate::renderer::{FrameRenderer, Progress, RenderError, Renderer, Step};
use crate::tasks::Files;
use crate::tasks::cache;
use bytes::Bytes;
use forelight_protocol::{
    CacheMode, FinishedPixels, LogLevel, RenderArtifacts, RenderResult, RenderSpec, TaskResult,
};
use forelight_tracer::{Cache, CacheError, Pixel, Profile, Totals};
use std::cell::Cell;
use std::sync::Once;
use std::time::Instant;

/// Renders a frame and writes its pictures.
pub(crate) fn render(
    renderer: &dyn Renderer,
    spec: &RenderSpec,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let start = Instant::now();
    let ready = renderer.frame(spec.frame, &spec.settings)?;
    let ready = &*ready;
    control.log(LogLevel::Info, format!("frame {} calls for: {}", spec.frame, ready.effects().join(", ")));
    if spec.cache.is_some() {
        share(ready, cache::only_file(assignment)?, control)?;
    }
    let mut rendered = match spec.work {
        None => evenly(ready, spec, assignment, control)?,
        Some(work) => for_work(ready, spec, work, control)?,
    };
    let seen = ready.preview()?;
    let picture = forelight_preview::picture(&seen.preview, &rendered.frame);
    let (pictures, encoding) = encode(&rendered.image, &rendered.frame, &picture)?;
    let written = write_cost(encoding, seen.spent);
    rendered.stats.cpu_seconds += seconds(written.cpu_nanos);
    rendered.stats.wall_seconds = start.elapsed().as_secs_f64();
    let stats = &rendered.stats;
    control.log(
        LogLevel::Info,
        format!(
            "rendered {} × {} pixels, {} of them taken over: {:.1} CPU seconds, {} operations",
            stats.width, stats.height, stats.reused_pixels, stats.cpu_seconds, stats.work
        ),
    );
    let mut files = Files::default();
    let artifacts = RenderArtifacts {
        image_exr: files.add(pictures.image_exr),
        image_png: files.add(pictures.image_png),
        cost_map_png: files.add(pictures.cost_map_png),
        preview_png: Some(files.add(pictures.preview_png)),
    };
    let result = RenderResult { stats: rendered.stats, artifacts };
    Ok(Outcome { result: TaskResult::Render(result), artifacts: files.contents })
}

/// With the camera samples of the settings for every pixel, taking over what was profiled, or what an earlier worker finished.
fn evenly(
    ready: &dyn FrameRenderer,
    spec: &RenderSpec,
    assignment: &Assignment,
    control: &Control,
) -> Result<Rendered, ExecuteError> {
    let cached = spec.settings.cache == CacheMode::On;
    // With an irradiance cache no pixels are kept.
    let checkpoint = assignment.checkpoint.as_ref().filter(|_| !cached);
    let finished = checkpoint.and_then(|bytes| usable("an earlier worker's tiles", bytes, ready, control));
    if let Some(finished) = &finished {
        let text = format!("goes on from {} pixels that an earlier worker finished", finished.pixels.len());
        control.log(LogLevel::Info, text);
    }
    let profiled = || usable("the frame's profile", assignment.profile.as_ref()?, ready, control);
    let reuse = finished.or_else(profiled);
    // With an irradiance cache the pixels are the lesser part, and worth little without it.
    let start_of_checkpoints = (!cached).then(|| reuse.clone().unwrap_or_else(|| ready.profile(&[])));
    let checkpoints = Checkpoints::new(control, start_of_checkpoints, spec.settings.pixels());
    let count = |pixels: &[(u32, Pixel)]| {
        let sum = |of: fn(&Pixel) -> u64| pixels.iter().map(|(_, pixel)| of(pixel)).sum();
        control.finished_pixels(FinishedPixels {
            done: pixels.len() as u64,
            all: spec.settings.pixels(),
            work: sum(|pixel| pixel.work),
            cpu_nanos: sum(|pixel| pixel.cpu_nanos),
        });
    };
    if !cached {
        count(reuse.as_ref().map_or(&[], |profile| &profile.pixels));
    }
    let begun = Once::new();
    let finished = |pixels: &[_]| {
        // Pixels are begun once the irradiance cache is there. Before, nothing is known of them, nor how much the cache is in comparison.
        begun.call_once(|| control.spent_before_pixels(ready.spent_on_cache()));
        count(pixels);
        checkpoints.finished(pixels);
    };
    let progress = |progress: Progress| control.set_progress(fraction(progress, cached));
    render_ready(ready, &spec.settings, reuse.as_ref(), &progress, &finished, control.cancelled())?
        .ok_or(ExecuteError::Cancelled)
}

/// With camera samples where they pay, for so much work all together. What other workers began of it is of no use: which samples a pixel gets is
/// known with its last pass.
fn for_work(
    ready: &dyn FrameRenderer,
    spec: &RenderSpec,
    work: u64,
    control: &Control,
) -> Result<Rendered, ExecuteError> {
    let cached = spec.settings.cache == CacheMode::On;
    let progress = |progress: Progress| control.set_progress(fraction(progress, cached));
    if !ready.fill(&progress, control.cancelled()) {
        return Err(ExecuteError::Cancelled);
    }
    control.spent_before_pixels(ready.spent_on_cache());
    let all = spec.settings.pixels();
    let told = Cell::new(FinishedPixels::default());
    let passed = |share: f64, totals: &Totals| {
        let before = told.get();
        let done = (share * all as f64) as u64;
        let now = FinishedPixels { done, all, work: totals.work, cpu_nanos: totals.cpu_nanos };
        told.set(now);
        control.finished_pixels(FinishedPixels {
            done: now.done - before.done,
            work: now.work - before.work,
            cpu_nanos: now.cpu_nanos - before.cpu_nanos,
            all,
        });
    };
    let start = Instant::now();
    let made = render_for_work(ready, work, &progress, &passed, control.cancelled())?;
    let made = made.ok_or(ExecuteError::Cancelled)?;
    Ok(made.rendered(ready, &spec.settings, None, start.elapsed().as_secs_f64()).rendered)
}

/// Gives the frame the irradiance cache that it shares with others. One that another version of the renderer made, before workers were
/// brought up to date, is of no use to this one: then the frame makes its own.
fn share(ready: &dyn FrameRenderer, cache: &Bytes, control: &Control) -> Result<(), ExecuteError> {
    let shared = Cache::from_bytes(cache).map_err(RenderError::from).and_then(|cache| ready.share(cache));
    let (level, text) = match shared {
        Ok(shared) => {
            let (kept, dropped) = (shared.kept.iter().sum::<u64>(), shared.dropped.iter().sum::<u64>());
            let text =
                format!("of the shot's irradiance cache {kept} records hold in this frame, {dropped} do not");
            (LogLevel::Info, text)
        }
        Err(RenderError::Cache(error @ (CacheError::Foreign | CacheError::OtherScene(_)))) => {
            let text =
                format!("the frame makes its own irradiance cache; that of the shot cannot be used: {error}");
            (LogLevel::Warn, text)
        }
        Err(error) => return Err(cache::of_shared_cache(error)),
    };
    control.log(level, text);
    Ok(())
}

/// What was finished of the frame before, if that is of use here: it is a help, and no part of the task. Another version of the renderer may have
/// made it.
fn usable(what: &str, bytes: &Bytes, ready: &dyn FrameRenderer, control: &Control) -> Option<Profile> {
    let found = Profile::from_bytes(bytes).map_err(RenderError::from);
    match found.and_then(|found| ready.check(&found).map(|()| found)) {
        Ok(found) => Some(found),
        Err(why) => {
            control.log(LogLevel::Warn, format!("{what} cannot be used: {why}"));
            None
        }
    }
}

/// How much of a render is done, 0 to 1. An irradiance cache is given the first half: it takes about that.
fn fraction(Progress { step, done, all }: Progress, cached: bool) -> f64 {
    let part = done as f64 / all.max(1) as f64;
    match (step, cached) {
        (Step::Planning, _) => 0.0,
        (Step::Filling, _) => 0.5 * part,
        (Step::Tracing, true) => 0.5 + 0.5 * part,
        (Step::Tracing, false) => part,
    }
}
