//! `--cache-error`: the settings of the irradiance cache follow from an error.

use super::blocking;
use anyhow::Result;
use forelight_protocol::RenderSettings;
use forelight_renderer_own::{choose_cache, seconds as seconds_of};
use forelight_terminal::failure::BadInput;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions, positive};
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::seconds;
use forelight_terminal::watching::AccuracyWatcher;
use std::path::Path;

/// The error that an irradiance cache may leave.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Image and quality")]
pub struct CacheErrorOption {
    /// Choose the cheapest settings of the irradiance cache by which it changes the image by at most this
    /// percentage of its mean (root mean square over blocks of 4 x 4 pixels, without the noise of pixels). Two
    /// small images are rendered for the choice. Replaces --cache, --cache-accuracy and --cache-rays
    #[arg(long, value_name = "PERCENT", value_parser = positive, conflicts_with_all = ["cache", "cache_accuracy", "cache_rays"])]
    cache_error: Option<f64>,
}

impl CacheErrorOption {
    pub fn is_given(&self) -> bool {
        self.cache_error.is_some()
    }

    /// The flags, with a cache if one will be chosen.
    pub fn quality(&self, quality: &QualityOptions) -> Result<QualityOptions> {
        Ok(if self.is_given() { quality.cached()? } else { quality.clone() })
    }

    /// The flags for a job, whose frames a farm renders: this machine chooses the cache for one of its frames, the
    /// middle one unless it is named.
    pub async fn for_farm(
        &self,
        bundle: &Path,
        quality: &QualityOptions,
        frame: Option<u32>,
        bars: &Bars,
        interrupt: &Interrupt,
    ) -> Result<QualityOptions> {
        if !self.is_given() {
            quality.check()?;
            return Ok(quality.clone());
        }
        let (option, bundle, quality) = (self.clone(), bundle.to_owned(), quality.clone());
        let (bars, interrupt) = (bars.clone(), interrupt.clone());
        let choose = move || {
            let machine = MachineOptions::default();
            let local = Local::open(&bundle, &machine, &bars)?;
            let frame = frame.unwrap_or(local.shot.info().summary.frames / 2);
            let RenderSettings { cache_accuracy, cache_rays, .. } =
                option.settings((&local, &bundle), &quality, frame, &bars, &interrupt)?;
            let quality = quality.cached()?;
            Ok(QualityOptions {
                cache_accuracy: Some(cache_accuracy),
                cache_rays: Some(cache_rays),
                ..quality
            })
        };
        // Tracing light would block the runtime.
        blocking(choose).await
    }

    /// The settings for these flags. Those of the cache are chosen for a frame.
    pub fn settings(
        &self,
        (local, bundle): (&Local, &Path),
        quality: &QualityOptions,
        frame: u32,
        bars: &Bars,
        interrupt: &Interrupt,
    ) -> Result<RenderSettings> {
        let settings = local.settings(&self.quality(quality)?)?;
        let Some(percent) = self.cache_error else { return Ok(settings) };
        if settings.ambient_bounces == 0 {
            let reason = "--cache-error: without ambient bounces, there is no indirect light to keep";
            return Err(BadInput::new(reason).hint("add --ambient-bounces 1").into());
        }
        let watcher = AccuracyWatcher::new(bars, "choosing the cache", interrupt);
        let choose = || choose_cache(&local.shot, frame, &settings, percent / 100.0, &watcher);
        let chosen = watcher.done(local.pool.install(choose), bundle)?;
        let Some(chosen) = chosen else {
            let reason = format!("--cache-error {percent}: no irradiance cache is so accurate here");
            return Err(BadInput::new(reason).hint("allow a larger error, or leave out the cache").into());
        };
        bars.note(format!(
            "irradiance cache: --cache on --cache-accuracy {} --cache-rays {}; forecast error {:.2} %; chosen in {} of \
             CPU time",
            f64::from(chosen.accuracy) / 1000.0,
            chosen.rays,
            100.0 * chosen.error,
            seconds(seconds_of(chosen.spent.cpu_nanos)),
        ));
        Ok(chosen.settings(&settings))
    }
}
