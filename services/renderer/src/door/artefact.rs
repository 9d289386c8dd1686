//! What was measured and need not be rendered again.

use super::{Part, RendererError, RendererId, Settings};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A file with a finished part of a frame, which a render may take over.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Artefact {
    /// Its maker. Another version's artefacts are not taken over.
    pub renderer: RendererId,
    /// Number of the frame.
    pub frame: i32,
    /// Settings that it was made with.
    pub settings: Settings,
    /// The part that it holds.
    pub part: Part,
    /// The file.
    pub path: PathBuf,
}

impl Artefact {
    /// Checks that the artefact is part of this very frame.
    ///
    /// # Errors
    /// What differs.
    pub fn check(&self, by: &RendererId, frame: i32, settings: &Settings) -> Result<(), RendererError> {
        let differs = if &self.renderer != by {
            format!("{} made it, and {by} renders", self.renderer)
        } else if self.frame != frame {
            format!("it is part of frame {}, not {frame}", self.frame)
        } else if &self.settings != settings {
            "it was made at other settings".to_owned()
        } else {
            return Ok(());
        };
        Err(self.unusable(differs))
    }

    /// The error that says why this artefact cannot be taken over.
    pub fn unusable(&self, reason: impl Into<String>) -> RendererError {
        RendererError::Artefact { path: self.path.clone(), reason: reason.into() }
    }
}
