//! One frame, rendered, with its true cost.

pub(crate) mod denoised;
pub(crate) mod pictures;

use crate::answers::{CacheUse, Finished, Progress};
use crate::costs::{own_records, seconds, spent};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use crate::profile::work_classes::of_frame;
use crate::shot::OwnShot;
use forelight_denoise::Denoiser;
use forelight_protocol::{CacheStats, Rays, RenderSettings, RenderStats, Spent};
use forelight_renderer::door::Run;
use forelight_scene::Frame;
use forelight_tracer::{Cache, CacheTotals, Image, PixelsFinished, Profile};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// A finished frame.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// The image.
    pub image: Image,
    /// Its cost.
    pub stats: RenderStats,
    /// The frame, for the data written beside the colours.
    pub frame: Frame,
}

/// What a render is given beside its settings.
#[derive(Debug, Default)]
pub struct Given<'a> {
    /// Its profile: finished pixels, or its cache.
    pub profile: Option<&'a Profile>,
    /// The shared cache.
    pub cache: Option<Cache>,
    /// Removes the noise of the finished image. Only [`render_frame`] uses it.
    pub denoiser: Option<&'a Denoiser>,
}

/// Renders one frame on the current thread pool, taking over what is given. `None` if `cancel` was set.
///
/// Its cost is the cost that forecasts predict: pixels, set-up, its own irradiance cache and, if something
/// moves in the shot, its acceleration structure, even if some of it was computed before. It excludes what a
/// process pays once (loading, a structure that all frames share) and the shared cache. Removing its noise is
/// part of it, and also told apart: [`forelight_protocol::DenoisedStats`].
pub fn render_frame(
    shot: &OwnShot,
    frame: u32,
    settings: &RenderSettings,
    given: Given<'_>,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Option<Rendered>, RenderError> {
    let start = Instant::now();
    let ready = shot.frame(frame, settings)?;
    given.cache.map_or(Ok(()), |cache| ready.share(cache).map(drop))?;
    let rendered = render_ready(&ready, settings, given.profile, progress, &|_| (), cancel)?;
    let Some(mut rendered) = rendered else { return Ok(None) };
    if let Some(denoiser) = given.denoiser {
        let denoise = |run: &Run<'_>| denoised::denoise(&ready, &mut rendered, denoiser, run, progress);
        let Some(()) = denoised::with_folder(cancel, denoise)? else { return Ok(None) };
    }
    rendered.stats.wall_seconds = start.elapsed().as_secs_f64();
    Ok(Some(rendered))
}

/// The same for a frame that is set up. `pixels` receives pixels as they are finished. Wall time is that of
/// tracing alone.
pub fn render_ready(
    ready: &OwnFrame<'_>,
    settings: &RenderSettings,
    reuse: Option<&Profile>,
    progress: &(dyn Fn(Progress) + Sync),
    pixels: &PixelsFinished<'_>,
    cancel: &AtomicBool,
) -> Result<Option<Rendered>, RenderError> {
    let start = Instant::now();
    let Some(finished) = ready.render(reuse, progress, pixels, cancel)? else { return Ok(None) };
    Ok(Some(rendered(ready, finished, settings, start.elapsed().as_secs_f64())))
}

pub(crate) fn rendered(
    ready: &OwnFrame<'_>,
    finished: Finished,
    settings: &RenderSettings,
    wall_seconds: f64,
) -> Rendered {
    let stats = stats(ready, &finished, settings, wall_seconds);
    Rendered { stats, image: finished.image, frame: ready.frame().clone() }
}

fn stats(
    ready: &OwnFrame<'_>,
    finished: &Finished,
    settings: &RenderSettings,
    wall_seconds: f64,
) -> RenderStats {
    let (all, reused) = (finished.image.totals(), finished.image.reused_totals());
    let gathered = finished.cache.as_ref().map(|cache| &cache.all);
    let taken_over = finished.cache.as_ref().map(|cache| &cache.taken_over);
    let fill = gathered.map_or(Spent::default(), |cache| spent(cache.fill));
    let fixed = ready.fixed();
    let cost = Spent { work: all.work, cpu_nanos: all.cpu_nanos }.plus(fixed.total()).plus(fill);
    let reused_cost = taken_over
        .map_or(Spent::default(), |cache| spent(cache.plan + cache.fill))
        .plus(Spent { work: reused.work, cpu_nanos: reused.cpu_nanos });
    let rays = |cache: Option<&CacheTotals>, pixels: [u64; 7]| {
        let of_cache = |kind: usize| cache.map_or(0, |cache| cache.plan_rays[kind] + cache.fill_rays[kind]);
        Rays::from_array(std::array::from_fn(|kind| pixels[kind] + of_cache(kind)))
    };
    let mut work_by_ray = Rays::from_array(all.work_by_ray);
    work_by_ray.ambient += fixed.plan.work + fill.work;
    RenderStats {
        frame: ready.frame().number,
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        allotted: None,
        denoised: None,
        once: Some(ready.once()),
        effects: ready.effects(),
        left_out: ready.left_out(),
        rays: rays(gathered, all.rays),
        cache_records: ready.cache_records().into_iter().map(u64::from).collect(),
        cache: finished.cache.as_ref().map(|cache| cache_stats(cache, &finished.image)),
        cache_choice: None,
        work: cost.work,
        work_by_class: of_frame(ready, all.work as f64, fill.work as f64),
        work_by_ray: Some(work_by_ray),
        cpu_seconds: seconds(cost.cpu_nanos),
        wall_seconds,
        peak_rss_bytes: forelight_renderer::peak_rss_bytes(),
        reused_pixels: reused.pixels,
        reused_rays: rays(taken_over, reused.rays).total(),
        reused_work: reused_cost.work,
        reused_cpu_seconds: seconds(reused_cost.cpu_nanos),
    }
}

fn cache_stats(cache: &CacheUse, image: &Image) -> CacheStats {
    CacheStats {
        plan_work: cache.all.plan.work,
        fill_work: cache.all.fill.work,
        rejected: cache.all.rejected,
        uncovered: image.pixels.iter().map(|pixel| u64::from(pixel.uncovered)).sum(),
        reused_records: cache.taken_over.filled,
        shared_records: cache.shared.kept.iter().sum(),
        dropped_records: cache.shared.dropped.iter().sum(),
        own_records: own_records(&cache.all.records, &cache.shared).iter().sum(),
        secondary_lights: cache.all.secondary_lights,
    }
}
