//! Rungs whose camera samples follow from an error, and denoised ones. Does all that `forelight render` does
//! after loading.

use super::picture::Picture;
use super::rendered::Rendered;
use anyhow::{Context, Result};
use forelight_denoise::Denoiser;
use forelight_preview::Choice;
use forelight_protocol::{Confidence, RenderSettings};
use forelight_renderer_own::{Aim, AllotOptions, Given, OwnRenderer, OwnShot, render_allotted, render_frame};
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::watching::{Stopping, allotment_failure};
use forelight_tracer::process_cpu_nanos;
use std::path::Path;
use std::time::Instant;

/// Number of profiled pixels.
const SAMPLES: u32 = 256;

/// A bundle, opened as by a farm's worker.
pub struct Opened {
    shot: OwnShot,
    frame: u32,
}

impl Opened {
    pub fn open(bundle: &Path, frame: u32, settings: &RenderSettings) -> Result<Self> {
        let shot = OwnRenderer::new(Choice::Cpu).open(bundle);
        let shot = shot.with_context(|| format!("bundle {}", bundle.display()))?;
        shot.frame(frame, settings)?;
        Ok(Self { shot, frame })
    }

    /// Renders on the current thread pool, with an even chance of at most this error.
    pub fn render(&self, settings: &RenderSettings, error: f64, interrupt: &Interrupt) -> Result<Rendered> {
        let (start, used) = (Instant::now(), process_cpu_nanos());
        let options =
            AllotOptions { aim: Aim::Error(error), confidence: Confidence::P50, samples: SAMPLES, seed: 0 };
        let stopping = Stopping(interrupt);
        let rendered =
            render_allotted(&self.shot, self.frame, settings, Given::default(), &options, &|_| (), &stopping);
        let rendered = rendered.map_err(|error| allotment_failure("--error", error))?;
        Ok(summary(&rendered.ok_or(Interrupted)?.rendered, start, used))
    }

    /// Renders on the current thread pool, and removes the noise. The cost includes measuring the error.
    pub fn denoised(
        &self,
        settings: &RenderSettings,
        denoiser: &Denoiser,
        interrupt: &Interrupt,
    ) -> Result<Rendered> {
        let (start, used) = (Instant::now(), process_cpu_nanos());
        let given = Given { denoiser: Some(denoiser), ..Given::default() };
        let rendered = render_frame(&self.shot, self.frame, settings, given, &|_| (), interrupt.flag())?;
        Ok(summary(&rendered.ok_or(Interrupted)?, start, used))
    }
}

/// The image and its cost since `start`, when the process had used so many nanoseconds.
fn summary(rendered: &forelight_renderer_own::Rendered, start: Instant, used: u64) -> Rendered {
    let (cpu_nanos, wall_seconds) = (process_cpu_nanos() - used, start.elapsed().as_secs_f64());
    let stats = &rendered.stats;
    let forecast = stats.allotted.as_ref().and_then(|allotted| allotted.forecast.as_ref());
    let profiled = forecast.map_or(0, |forecast| forecast.profiling_work);
    let cache = stats.cache.as_ref();
    let by_others = stats.denoised.as_ref().map_or(0.0, |denoised| denoised.denoiser_cpu_seconds);
    Rendered {
        picture: Picture::of(&rendered.image),
        work: stats.work + profiled,
        plan: cache.map_or(0, |cache| cache.plan_work),
        fill: cache.map_or(0, |cache| cache.fill_work),
        records: stats.cache_records.clone(),
        cpu_seconds: cpu_nanos as f64 * 1e-9 + by_others,
        wall_seconds,
    }
}
