//! The render task: equally many camera samples for every pixel, or a given amount of work.

use crate::adaptive::work_budget::render_for_work;
use crate::answers::Progress;
use crate::costs::seconds;
use crate::frame::OwnFrame;
use crate::render::pictures::{encode, write_cost};
use crate::render::{Rendered, render_ready};
use crate::shot::OwnShot;
use crate::tasks::checkpoint::Checkpoints;
use crate::tasks::given::{self, own, usable};
use crate::tasks::progress::{count, fraction};
use crate::tasks::whole::{passes_put_together, put_together};
use forelight_protocol::{
    CacheMode, FinishedPixels, LogLevel, RenderArtifacts, RenderResult, RenderSettings, RenderSpec,
    TaskResult,
};
use forelight_renderer::{Assignment, Control, ExecuteError, Files, Outcome};
use forelight_tracer::{Pixel, Profile, Totals};
use std::cell::Cell;
use std::sync::Once;
use std::time::Instant;

pub(crate) fn render(
    shot: &OwnShot,
    spec: &RenderSpec,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let start = Instant::now();
    let settings = own(&spec.settings)?;
    let ready = shot.frame(spec.frame, settings)?;
    let ready = &ready;
    control.log(LogLevel::Info, format!("effects of frame {}: {}", spec.frame, ready.effects().join(", ")));
    let mut rendered = if spec.parts.is_empty() {
        given::caches(ready, (spec.cache, spec.frame_cache), true, assignment, control)?;
        match spec.work {
            None => evenly(ready, settings, assignment, control)?,
            Some(work) => for_work(ready, settings, work, control)?,
        }
    } else {
        let given::Start { profile, .. } =
            given::start(ready, (spec.cache, spec.frame_cache), assignment, control)?;
        match spec.work {
            None => put_together(ready, settings, profile, assignment, control)?,
            Some(work) => match passes_put_together(ready, settings, work, assignment, control)? {
                Some(rendered) => rendered,
                None => for_work(ready, settings, work, control)?,
            },
        }
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
            "rendered {} × {} pixels, {} of them taken over: {:.1} CPU seconds, {} units of work",
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

/// Renders with the camera samples of the settings, taking over profiled pixels or a checkpoint.
fn evenly(
    ready: &OwnFrame<'_>,
    settings: &RenderSettings,
    assignment: &Assignment,
    control: &Control,
) -> Result<Rendered, ExecuteError> {
    let cached = settings.cache == CacheMode::On;
    // Frames with an irradiance cache have no checkpoints: their pixels are worth little without it.
    let checkpoint = assignment.checkpoint.as_ref().filter(|_| !cached);
    let finished = checkpoint.and_then(|bytes| usable("an earlier worker's tiles", bytes, ready, control));
    if let Some(finished) = &finished {
        let text =
            format!("continuing from {} pixels that an earlier worker finished", finished.pixels.len());
        control.log(LogLevel::Info, text);
    }
    let profiled = || usable("the frame's profile", assignment.profile.as_ref()?, ready, control);
    let reuse = finished.or_else(profiled);
    let start_of_checkpoints = (!cached).then(|| reuse.clone().unwrap_or_else(|| ready.profile(&[])));
    let checkpoints = Checkpoints::new(control, start_of_checkpoints, Profile::bytes_of(settings.pixels()));
    let count = |pixels: &[(u32, Pixel)]| count(pixels, settings.pixels(), control);
    if !cached {
        count(reuse.as_ref().map_or(&[], |profile| &profile.pixels));
    }
    let begun = Once::new();
    let finished = |pixels: &[_]| {
        // Pixels start once the irradiance cache is filled. Only then is its share of the frame known.
        begun.call_once(|| control.spent_before_pixels(ready.spent_on_cache()));
        count(pixels);
        checkpoints.finished(pixels);
    };
    let progress = |progress: Progress| control.set_progress(fraction(progress, cached));
    render_ready(ready, settings, reuse.as_ref(), &progress, &finished, control.cancelled())?
        .ok_or(ExecuteError::Cancelled)
}

/// Renders with `work` in all. Checkpoints do not help: only the last pass decides a pixel's samples.
fn for_work(
    ready: &OwnFrame<'_>,
    settings: &RenderSettings,
    work: u64,
    control: &Control,
) -> Result<Rendered, ExecuteError> {
    let cached = settings.cache == CacheMode::On;
    let progress = |progress: Progress| control.set_progress(fraction(progress, cached));
    if !ready.fill(&progress, control.cancelled()) {
        return Err(ExecuteError::Cancelled);
    }
    control.spent_before_pixels(ready.spent_on_cache());
    let all = settings.pixels();
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
    Ok(made.rendered(ready, settings, None, start.elapsed().as_secs_f64()).rendered)
}
