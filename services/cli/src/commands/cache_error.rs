//! `--cache-error`: the settings of the irradiance cache follow from an error.

use super::blocking;
use anyhow::Result;
use forelight_protocol::{CacheChoice, FrameSet, RenderSettings};
use forelight_renderer_own::{choose_cache, seconds as seconds_of};
use forelight_terminal::failure::BadInput;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions, positive};
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::seconds;
use forelight_terminal::watching::AccuracyWatcher;
use std::path::{Path, PathBuf};

/// The error that an irradiance cache may leave.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Image and quality")]
pub struct CacheErrorOption {
    /// Choose the cheapest settings of the irradiance cache by which it changes the image by at most this
    /// percentage of its mean: a root mean square over blocks of 4 x 4 pixels, without the noise of pixels. This
    /// machine renders two small images for the choice, of the frame or the middle one of several. Replaces --cache,
    /// --cache-accuracy and --cache-rays
    #[arg(
        long,
        value_name = "PERCENT",
        value_parser = positive,
        conflicts_with_all = ["cache", "cache_accuracy", "cache_rays"]
    )]
    cache_error: Option<f64>,
}

/// Who asks about an open bundle.
pub struct Asker<'a> {
    pub local: &'a Local,
    pub bundle: &'a Path,
    pub bars: &'a Bars,
    pub interrupt: &'a Interrupt,
}

impl CacheErrorOption {
    pub fn is_given(&self) -> bool {
        self.cache_error.is_some()
    }

    /// The flags, with a cache if one will be chosen.
    pub fn quality(&self, quality: &QualityOptions) -> Result<QualityOptions> {
        Ok(if self.is_given() { quality.cached()? } else { quality.clone() })
    }

    /// The settings of these flags. The cache is chosen on the middle one of these frames, all if `None`.
    pub fn settings(
        &self,
        quality: &QualityOptions,
        frames: Option<&FrameSet>,
        asker: &Asker<'_>,
    ) -> Result<RenderSettings> {
        let mut settings = asker.local.settings(&self.quality(quality)?)?;
        let middle = asker.local.middle_frame(frames)?;
        self.choose(&mut settings, middle, asker)?;
        Ok(settings)
    }

    /// Chooses the cache of these settings on a frame, if it is asked for, and tells the user.
    pub fn choose(
        &self,
        settings: &mut RenderSettings,
        frame: u32,
        asker: &Asker<'_>,
    ) -> Result<Option<CacheChoice>> {
        let Some(percent) = self.cache_error else { return Ok(None) };
        if settings.ambient_bounces == 0 {
            let reason = "--cache-error: without ambient bounces, there is no indirect light to keep";
            return Err(BadInput::new(reason).hint("add --ambient-bounces 1").into());
        }
        let Asker { local, bundle, bars, interrupt } = asker;
        let watcher = AccuracyWatcher::new(bars, "choosing the cache", interrupt);
        let choose = || choose_cache(&local.shot, frame, settings, percent / 100.0, &watcher);
        let chosen = watcher.done(local.pool.install(choose), bundle)?;
        if chosen.error > percent / 100.0 {
            let best = 100.0 * chosen.error;
            let reason =
                format!("--cache-error {percent}: the best cache here is forecast to leave {best:.2} %");
            return Err(BadInput::new(reason).hint("allow a larger error, or leave out the cache").into());
        }
        *settings = chosen.settings(settings);
        let choice = CacheChoice {
            cache_accuracy: chosen.accuracy,
            cache_rays: chosen.rays,
            error: chosen.error,
            cpu_seconds: seconds_of(chosen.spent.cpu_nanos),
        };
        bars.note(format!(
            "irradiance cache: --cache on --cache-accuracy {} --cache-rays {}; forecast error {:.2} %; chosen in {} of \
             CPU time",
            f64::from(choice.cache_accuracy) / 1000.0,
            choice.cache_rays,
            100.0 * choice.error,
            seconds(choice.cpu_seconds),
        ));
        Ok(Some(choice))
    }

    /// The flags for a job of these frames, all if `None`, which a farm renders. This machine chooses the cache.
    pub async fn for_farm(
        &self,
        quality: &QualityOptions,
        frames: Option<FrameSet>,
        (bundle, machine): (&Path, &MachineOptions),
        (bars, interrupt): (&Bars, &Interrupt),
    ) -> Result<QualityOptions> {
        if !self.is_given() {
            quality.check()?;
            return Ok(quality.clone());
        }
        let choice = Choice {
            option: self.clone(),
            quality: quality.cached()?,
            frames,
            bundle: bundle.to_owned(),
            machine: machine.clone(),
            bars: bars.clone(),
            interrupt: interrupt.clone(),
        };
        // Tracing light would block the runtime.
        blocking(move || choice.make()).await
    }
}

/// A choice for a job.
struct Choice {
    option: CacheErrorOption,
    quality: QualityOptions,
    frames: Option<FrameSet>,
    bundle: PathBuf,
    machine: MachineOptions,
    bars: Bars,
    interrupt: Interrupt,
}

impl Choice {
    fn make(self) -> Result<QualityOptions> {
        let Self { option, quality, frames, bundle, machine, bars, interrupt } = &self;
        let local = Local::open(bundle, machine, bars)?;
        let here = Asker { local: &local, bundle, bars, interrupt };
        let settings = option.settings(quality, frames.as_ref(), &here)?;
        Ok(QualityOptions {
            cache_accuracy: Some(settings.cache_accuracy),
            cache_rays: Some(settings.cache_rays),
            ..quality.clone()
        })
    }
}
