//! What a command prints: progress, and messages of known meaning.

use crate::file::{CommandFile, ProgressUnit};
use forelight_renderer::door::{RendererError, Run};
use forelight_renderer::process::Meaning;

/// Listens to one run.
pub(crate) struct Listener<'a> {
    file: &'a CommandFile,
    /// The first known message, and its meaning.
    heard: Option<(Meaning, String)>,
}

impl<'a> Listener<'a> {
    pub fn new(file: &'a CommandFile) -> Self {
        Self { file, heard: None }
    }

    /// Hears a line.
    pub fn hear(&mut self, line: &str, run: &Run<'_>) {
        if let Some(progress) = &self.file.progress
            && let Some(number) = progress.pattern.find(line).and_then(|text| text.parse::<f64>().ok())
        {
            let share = if progress.unit == ProgressUnit::Percent { number / 100.0 } else { number };
            (run.progress)(share.clamp(0.0, 1.0));
        }
        if self.heard.is_none() {
            let known = self.file.errors.iter().find(|known| known.pattern.0.is_match(line));
            self.heard = known.map(|known| (known.meaning(), line.to_owned()));
        }
    }

    /// The error of a run that failed. A known message tells more than how the program ended; it does not
    /// tell more than a limit that was exceeded.
    pub fn explain(&self, error: RendererError) -> RendererError {
        let is_vague = matches!(
            error,
            RendererError::Ended { .. }
                | RendererError::Failed(_)
                | RendererError::MissingFile(_)
                | RendererError::Licence(_)
                | RendererError::Gpu(_)
        );
        match &self.heard {
            Some((meaning, line)) if is_vague => error.explained_by(meaning.error(line.clone())),
            _ => error,
        }
    }
}
