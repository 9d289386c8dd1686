//! The render task: equally many camera samples for every pixel, or as many as a work or an error asks for.

use crate::adaptive::made::Made;
use crate::adaptive::passes::{PassPlan, render_in_passes};
use crate::answers::Progress;
use crate::costs::seconds;
use crate::error::RenderError;
use crate::frame::OwnFrame;
use crate::render::denoised::denoise;
use crate::render::pictures::{encode, write_cost};
use crate::render::{Rendered, render_ready};
use crate::shot::OwnShot;
use crate::tasks::Denoising;
use crate::tasks::checkpoint::Checkpoints;
use crate::tasks::given::{self, own, usable};
use crate::tasks::progress::{NOISY, count, fraction};
use crate::tasks::whole::{passes_put_together, put_together};
use forelight_protocol::{
    CacheMode, DenoisedStats, FinishedPixels, ImageError, LogLevel, Passes, RenderArtifacts, RenderResult,
    RenderSettings, RenderSpec, TaskResult,
};
use forelight_renderer::{Assignment, Control, ExecuteError, Files, Outcome, failure, with_run};
use forelight_tracer::{Pixel, Profile, Totals};
use std::cell::Cell;
use std::sync::Once;
use std::time::Instant;

pub(crate) fn render(
    shot: &OwnShot,
    spec: &RenderSpec,
    denoising: Option<&Denoising>,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let start = Instant::now();
    let settings = own(&spec.settings)?;
    let ready = shot.frame(spec.frame, settings)?;
    let ready = &ready;
    control.log(LogLevel::Info, format!("effects of frame {}: {}", spec.frame, ready.effects().join(", ")));
    let caches = (spec.cache, spec.frame_cache);
    // Of the task's progress, what comes before removing the noise.
    let share = if denoising.is_some() { NOISY } else { 1.0 };
    let mut rendered = match (spec.passes(), spec.parts.is_empty()) {
        (None, true) => {
            given::caches(ready, caches, true, assignment, control)?;
            evenly(ready, settings, share, assignment, control)?
        }
        (None, false) => {
            let given::Start { profile, .. } = given::start(ready, caches, assignment, control)?;
            put_together(ready, settings, (profile, share), assignment, control)?
        }
        (Some(passes), is_whole) => {
            let given::Start { profile, .. } = given::start(ready, caches, assignment, control)?;
            let start = Instant::now();
            let put_together =
                if is_whole { None } else { passes_put_together(ready, &passes, assignment, control)? };
            let mut made = match put_together {
                Some(made) => made,
                None => in_passes(ready, &passes, control)?,
            };
            made.finished.cache = ready.cache_use(ready.totals_of_profiled_cache(profile.as_ref())?);
            made.rendered(ready, settings, None, start.elapsed().as_secs_f64()).rendered
        }
    };
    if let Some(denoising) = denoising {
        remove_noise(ready, &mut rendered, denoising, assignment, control)?;
    }
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

/// Removes the noise of a finished frame, and measures what is left.
fn remove_noise(
    ready: &OwnFrame<'_>,
    rendered: &mut Rendered,
    denoising: &Denoising,
    assignment: &Assignment,
    control: &Control,
) -> Result<(), ExecuteError> {
    // A frame that is put together may have needed no cache. Its pixels do when they are traced again.
    if !ready.has_final_colours() && !ready.fill(&|_| (), control.cancelled()) {
        return Err(ExecuteError::Cancelled);
    }
    with_run(assignment, control, denoising.sandbox.as_deref(), |run| {
        let progress = |Progress { done, all, .. }: Progress| {
            control.set_progress(NOISY + (1.0 - NOISY) * done as f64 / all as f64);
        };
        let done = denoise(ready, rendered, &denoising.denoiser, run, &progress);
        done.map_err(|error| match error {
            RenderError::Denoiser(error) => failure(error, assignment),
            other => other.into(),
        })?
        .ok_or(ExecuteError::Cancelled)
    })?;
    if let Some(DenoisedStats { by, error, noisy, .. }) = &rendered.stats.denoised {
        let percent = |error: &ImageError| 100.0 * error.p50;
        let (error, noisy) = (percent(error), percent(noisy));
        let text = format!("denoised by {by}: error {error:.2} % of the mean in place of {noisy:.2} %");
        control.log(LogLevel::Info, text);
    }
    Ok(())
}

/// Renders with the camera samples of the settings, taking over profiled pixels or a checkpoint.
fn evenly(
    ready: &OwnFrame<'_>,
    settings: &RenderSettings,
    share: f64,
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
    let progress = |progress: Progress| control.set_progress(share * fraction(progress, cached));
    render_ready(ready, settings, reuse.as_ref(), &progress, &finished, control.cancelled())?
        .ok_or(ExecuteError::Cancelled)
}

/// Renders pass by pass. Checkpoints do not help: only the last pass decides a pixel's samples.
fn in_passes(ready: &OwnFrame<'_>, passes: &Passes, control: &Control) -> Result<Made, ExecuteError> {
    let fills = !ready.has_final_colours();
    let progress = |progress: Progress| control.set_progress(fraction(progress, fills));
    if !ready.fill(&progress, control.cancelled()) {
        return Err(ExecuteError::Cancelled);
    }
    control.spent_before_pixels(ready.spent_on_cache());
    let all = ready.frame().camera.pixels() as u64;
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
    let plan = PassPlan::of(ready, passes)?;
    let made = render_in_passes(ready, &plan, &progress, &passed, control.cancelled())?;
    made.ok_or(ExecuteError::Cancelled)
}
