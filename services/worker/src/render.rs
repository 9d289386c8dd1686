//! One frame, rendered, with its true cost.

use crate::renderer::{FrameRenderer, RenderError, Renderer};
use crate::shot::plus;
use forelight_protocol::{Rays, RenderSettings, RenderStats, Spent};
use forelight_scene::Frame;
use forelight_tracer::{Image, Profile};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// A finished frame.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// The image.
    pub image: Image,
    /// What it took.
    pub stats: RenderStats,
    /// The frame, for what is written beside the colours.
    pub frame: Frame,
}

/// Renders one frame on the current thread pool, taking over the pixels of `reuse`. `progress` is told the pixels done and all
/// pixels. `None` if `cancel` was set.
///
/// The cost of a frame is that of its pixels, of setting it up, and of building its acceleration structure in a shot in which something moves,
/// whether or not some of it was done before, by profiling or for another frame: it is what a forecast forecasts. Loading the
/// bundle and building the structure that all frames share, both paid once per process, are not in it.
pub fn render_frame(
    renderer: &dyn Renderer,
    frame: u32,
    settings: &RenderSettings,
    reuse: Option<&Profile>,
    progress: &(dyn Fn(u64, u64) + Sync),
    cancel: &AtomicBool,
) -> Result<Option<Rendered>, RenderError> {
    let start = Instant::now();
    let ready = renderer.frame(frame, settings)?;
    let rendered = render_ready(&*ready, settings, reuse, progress, cancel)?;
    Ok(rendered.map(|mut rendered| {
        rendered.stats.wall_seconds = start.elapsed().as_secs_f64();
        rendered
    }))
}

/// The same for a frame that was set up before; its wall time is that of tracing alone.
pub fn render_ready(
    ready: &dyn FrameRenderer,
    settings: &RenderSettings,
    reuse: Option<&Profile>,
    progress: &(dyn Fn(u64, u64) + Sync),
    cancel: &AtomicBool,
) -> Result<Option<Rendered>, RenderError> {
    let start = Instant::now();
    let pixels = settings.pixels();
    let Some(image) = ready.render(reuse, &|done| progress(done, pixels), cancel)? else { return Ok(None) };
    let stats = stats(ready, &image, settings, start.elapsed().as_secs_f64());
    Ok(Some(Rendered { stats, image, frame: ready.frame().clone() }))
}

fn stats(
    ready: &dyn FrameRenderer,
    image: &Image,
    settings: &RenderSettings,
    wall_seconds: f64,
) -> RenderStats {
    let (all, reused) = (image.totals(), image.reused_totals());
    let traced = Spent { work: all.work, cpu_nanos: all.cpu_nanos };
    let fixed = ready.fixed();
    let cost = plus(traced, fixed.total());
    RenderStats {
        frame: ready.frame().number,
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        effects: ready.effects(),
        rays: Rays::from_array(all.rays),
        cache_records: Vec::new(),
        work: cost.work,
        cpu_seconds: seconds(cost.cpu_nanos),
        wall_seconds,
        peak_rss_bytes: peak_rss_bytes(),
        reused_pixels: reused.pixels,
        reused_rays: reused.rays.iter().sum(),
        reused_work: reused.work,
        reused_cpu_seconds: seconds(reused.cpu_nanos),
    }
}

/// Nanoseconds as seconds.
pub fn seconds(nanos: u64) -> f64 {
    nanos as f64 * 1e-9
}

/// Largest resident memory of this process, in bytes (`VmHWM` of Linux); 0 where the system does not say.
pub fn peak_rss_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kibibytes = line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kibibytes.unwrap_or(0).saturating_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_a_peak_of_memory() {
        assert!(peak_rss_bytes() > 1 << 20);
    }
}
