//! Observers of long work: they show progress, and end the work when the user stops it.

use crate::failure::{BadInput, Interrupted};
use crate::interrupt::Interrupt;
use crate::local::Local;
use crate::output::Bars;
use anyhow::{Context, Result};
use forelight_protocol::RenderSettings;
use forelight_renderer_own::{AccuracyObserver, AllotError, Observer, Quote, QuoteOptions, ShotError, quote};
use indicatif::ProgressBar;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Progress bars for the steps of a quote.
pub struct QuoteWatcher<'a> {
    previews: ProgressBar,
    profiles: ProgressBar,
    interrupt: &'a Interrupt,
}

impl<'a> QuoteWatcher<'a> {
    /// Bars for a quote of this number of frames.
    pub fn new(bars: &Bars, frames: usize, interrupt: &'a Interrupt) -> Self {
        Self { previews: bars.bar("previews", frames as u64), profiles: bars.bar("profiling", 0), interrupt }
    }

    /// Quotes the bundle that `local` has opened, until the user stops it.
    pub fn quote(
        &self,
        local: &Local,
        bundle: &Path,
        frames: &[u32],
        settings: &RenderSettings,
        options: &QuoteOptions,
    ) -> Result<Quote> {
        let quoted = local.pool.install(|| quote(&local.shot, frames, settings, options, self));
        self.previews.finish_and_clear();
        self.profiles.finish_and_clear();
        of_bundle(quoted, bundle)
    }
}

impl Observer for QuoteWatcher<'_> {
    fn previewed(&self, done: usize, all: usize) {
        self.previews.set_length(all as u64);
        self.previews.set_position(done as u64);
    }

    fn profiled(&self, done: usize, all: usize) {
        self.profiles.set_length(all as u64);
        self.profiles.set_position(done as u64);
    }

    fn is_cancelled(&self) -> bool {
        self.interrupt.is_set()
    }
}

/// A progress bar for what accuracy costs.
pub struct AccuracyWatcher<'a> {
    bar: ProgressBar,
    interrupt: &'a Interrupt,
}

impl<'a> AccuracyWatcher<'a> {
    /// A bar with this name.
    pub fn new(bars: &Bars, name: &str, interrupt: &'a Interrupt) -> Self {
        Self { bar: bars.bar(name, 0), interrupt }
    }

    /// Ends the bar. An error says that the user stopped, or names the bundle.
    pub fn done<T>(&self, outcome: Result<T, ShotError>, bundle: &Path) -> Result<T> {
        self.bar.finish_and_clear();
        of_bundle(outcome, bundle)
    }
}

impl AccuracyObserver for AccuracyWatcher<'_> {
    fn predicted(&self, done: usize, all: usize) {
        self.bar.set_length(all as u64);
        self.bar.set_position(done as u64);
    }

    fn cancel(&self) -> &AtomicBool {
        self.interrupt.flag()
    }
}

/// An error says that the user stopped, or names the bundle.
fn of_bundle<T>(outcome: Result<T, ShotError>, bundle: &Path) -> Result<T> {
    match outcome {
        Err(ShotError::Cancelled) => Err(Interrupted.into()),
        Err(ShotError::Render(error)) => Err(error).with_context(|| format!("bundle {}", bundle.display())),
        other => Ok(other?),
    }
}

/// Observes only the user's wish to stop.
pub struct Stopping<'a>(pub &'a Interrupt);

impl AccuracyObserver for Stopping<'_> {
    fn predicted(&self, _: usize, _: usize) {}

    fn cancel(&self) -> &AtomicBool {
        self.0.flag()
    }
}

/// A limit from `flag` that is too small is wrong input. Any other error stays as it is.
pub fn allotment_failure(flag: &str, error: AllotError) -> anyhow::Error {
    match error {
        AllotError::TooLittle { .. } => BadInput::new(format!("{flag}: {error}"))
            .hint("set a higher limit, profile fewer pixels (--samples), or render a smaller image")
            .into(),
        AllotError::TooLittleForCache { .. } => BadInput::new(format!("{flag}: {error}"))
            .hint("set a higher limit, use a rougher cache (--cache-error, or --cache-rays and --cache-accuracy), or none (--cache off)")
            .into(),
        AllotError::Shot(ShotError::Render(error)) => error.into(),
        error => error.into(),
    }
}
