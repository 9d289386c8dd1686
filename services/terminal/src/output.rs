//! What goes to the terminal: results to standard output, progress to standard error where someone watches.

use anyhow::{Context, Result};
use forelight_renderer_own::{Progress, Step};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use parking_lot::Mutex;
use serde::Serialize;
use std::io::{ErrorKind, IsTerminal, Write};

/// Writes text to standard output. A reader that has gone away (`| head`) is not an error.
pub fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write to standard output"),
    }
}

/// Writes one line to standard output.
pub fn line(text: impl AsRef<str>) -> Result<()> {
    print(&format!("{}\n", text.as_ref()))
}

/// Writes a JSON document to standard output.
pub fn json<T: Serialize>(document: &T) -> Result<()> {
    line(pretty(document)?)
}

/// A JSON document as text.
pub fn pretty<T: Serialize>(document: &T) -> Result<String> {
    serde_json::to_string_pretty(document).context("cannot write JSON")
}

/// Names one after the other, or `none`.
pub fn list(names: &[impl AsRef<str>]) -> String {
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Progress bars: shown on a terminal, unless the output is for a machine.
#[derive(Debug, Clone)]
pub struct Bars {
    all: MultiProgress,
    /// Nobody watches, and somebody reads what was said later on: a log.
    logged: bool,
}

impl Bars {
    /// Bars that are shown if someone watches and `json` is not wanted.
    pub fn new(json: bool) -> Self {
        let watched = std::io::stderr().is_terminal();
        let shown = !json && watched;
        let target =
            if shown { ProgressDrawTarget::stderr_with_hz(10) } else { ProgressDrawTarget::hidden() };
        Self { all: MultiProgress::with_draw_target(target), logged: !json && !watched }
    }

    /// A bar of so many steps.
    pub fn bar(&self, name: &str, steps: u64) -> ProgressBar {
        // The template is constant; should it ever be wrong, the bar looks plain.
        let style = ProgressStyle::with_template("{prefix:>10} {bar:32} {pos}/{len} {elapsed} {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = self.all.add(ProgressBar::new(steps).with_style(style));
        bar.set_prefix(name.to_owned());
        bar.tick();
        bar
    }

    /// Something whose length is not known.
    pub fn spinner(&self, what: impl Into<String>) -> ProgressBar {
        let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}")
            .unwrap_or_else(|_| ProgressStyle::default_spinner());
        let spinner = self.all.add(ProgressBar::new_spinner().with_style(style));
        spinner.set_message(what.into());
        spinner.enable_steady_tick(std::time::Duration::from_millis(120));
        spinner
    }

    /// A line above the bars, or in a log; for people only.
    pub fn note(&self, text: impl AsRef<str>) {
        if self.logged {
            // A log that cannot be written is no reason to stop.
            let _ = writeln!(std::io::stderr(), "{}", text.as_ref());
        } else {
            // `println` of hidden bars says nothing, which is what a machine wants to read.
            let _ = self.all.println(text);
        }
    }
}

/// A bar for each step of a render, one after the other.
#[derive(Debug)]
pub struct RenderBar {
    bars: Bars,
    current: Mutex<Option<(Step, ProgressBar)>>,
}

impl RenderBar {
    /// Nothing is shown before the first step is told.
    pub fn new(bars: &Bars) -> Self {
        Self { bars: bars.clone(), current: Mutex::new(None) }
    }

    /// Shows how far the render is. May be called by many threads.
    pub fn show(&self, Progress { step, done, all }: Progress) {
        let name = match step {
            Step::Planning => "planning",
            Step::Filling => "filling",
            Step::Tracing => "rendering",
        };
        // Whoever panicked while it was held left a bar that can still be drawn.
        let mut current = self.current.lock();
        match &*current {
            Some((shown, bar)) if *shown == step => bar.set_position(done),
            before => {
                before.iter().for_each(|(_, bar)| bar.finish_and_clear());
                let bar = self.bars.bar(name, all);
                bar.set_position(done);
                *current = Some((step, bar));
            }
        }
    }
}

impl Drop for RenderBar {
    fn drop(&mut self) {
        let current = self.current.get_mut();
        current.iter().for_each(|(_, bar)| bar.finish_and_clear());
    }
}
