//! Output: results to standard output, and progress to standard error if it is a terminal.

use crate::foreign_text::{shown, shown_json, shown_lines};
use anyhow::{Context, Result};
use forelight_renderer_own::{Progress, Step};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use parking_lot::Mutex;
use serde::Serialize;
use std::io::{ErrorKind, IsTerminal, Write};

/// Writes lines to standard output, with what others wrote as it is shown. A closed pipe (`| head`) is not an
/// error.
pub fn print(text: &str) -> Result<()> {
    write(&shown_lines(text))
}

/// Clears the screen of a terminal.
pub fn clear_screen() -> Result<()> {
    write("\x1b[H\x1b[2J")
}

fn write(text: &str) -> Result<()> {
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

/// Writes a JSON document to standard output, in one line.
pub fn json_line<T: Serialize>(document: &T) -> Result<()> {
    line(shown_json(serde_json::to_string(document).context("cannot write JSON")?))
}

/// A JSON document as text.
pub fn pretty<T: Serialize>(document: &T) -> Result<String> {
    Ok(shown_json(serde_json::to_string_pretty(document).context("cannot write JSON")?))
}

/// Names separated by commas, or `none`.
pub fn list(names: &[impl AsRef<str>]) -> String {
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Progress bars. Shown on a terminal, unless the output is JSON.
#[derive(Debug, Clone)]
pub struct Bars {
    all: MultiProgress,
    /// Standard error is not a terminal, so notes go to it as a log.
    logged: bool,
}

impl Bars {
    /// Bars that are shown on a terminal if `json` is false.
    pub fn new(json: bool) -> Self {
        let watched = std::io::stderr().is_terminal();
        let shown = !json && watched;
        let target =
            if shown { ProgressDrawTarget::stderr_with_hz(10) } else { ProgressDrawTarget::hidden() };
        Self { all: MultiProgress::with_draw_target(target), logged: !json && !watched }
    }

    /// A bar with this number of steps.
    pub fn bar(&self, name: &str, steps: u64) -> ProgressBar {
        // The template is constant. If it were invalid, the bar would have the default style.
        let style = ProgressStyle::with_template("{prefix:>10} {bar:32} {pos}/{len} {elapsed} {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = self.all.add(ProgressBar::new(steps).with_style(style));
        bar.set_prefix(name.to_owned());
        bar.tick();
        bar
    }

    /// A spinner for work of unknown length.
    pub fn spinner(&self, what: impl Into<String>) -> ProgressBar {
        let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}")
            .unwrap_or_else(|_| ProgressStyle::default_spinner());
        let spinner = self.all.add(ProgressBar::new_spinner().with_style(style));
        spinner.set_message(shown(&what.into()).into_owned());
        spinner.enable_steady_tick(std::time::Duration::from_millis(120));
        spinner
    }

    /// Writes a line for people, above the bars or into the log.
    pub fn note(&self, text: impl AsRef<str>) {
        let text = shown_lines(text.as_ref());
        if self.logged {
            // If the log cannot be written, the work still continues.
            let _ = writeln!(std::io::stderr(), "{text}");
        } else {
            // `println` of hidden bars writes nothing, as JSON output requires.
            let _ = self.all.println(text);
        }
    }
}

/// One bar for each step of a render, in turn.
#[derive(Debug)]
pub struct RenderBar {
    bars: Bars,
    current: Mutex<Option<(Step, ProgressBar)>>,
}

impl RenderBar {
    /// Shows nothing before the first step is reported.
    pub fn new(bars: &Bars) -> Self {
        Self { bars: bars.clone(), current: Mutex::new(None) }
    }

    /// Shows the progress. Any thread may call it.
    pub fn show(&self, Progress { step, done, all }: Progress) {
        let name = match step {
            Step::Planning => "planning",
            Step::Filling => "filling",
            Step::Tracing => "rendering",
            Step::Denoising => "denoising",
        };
        // A panic while the lock was held leaves a bar that can still be drawn.
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
