//! The renderer's side of the door: what the program can, and how a scene is opened.

use crate::file::Can;
use crate::installation::CommandRenderer;
use crate::shot::CommandShot;
use forelight_renderer::door::{
    Capabilities, Capability, Cost, Description, Renderer, RendererError, RendererId, Run, Settings, Shot,
};
use serde_json::Value;
use std::path::Path;

impl Renderer for CommandRenderer {
    fn id(&self) -> &RendererId {
        &self.id
    }

    fn settings_schema(&self) -> Value {
        self.file.schema()
    }

    fn capabilities(&self) -> Capabilities {
        let can = self.file.can.iter().map(|can| match can {
            Can::Samples => Capability::MeasureSamples,
            Can::Size => Capability::Resize,
            Can::Crop => Capability::MeasureRegions,
        });
        can.collect()
    }

    /// Opens a scene. The renderer's own file stands for the scene that it names.
    fn open(&self, scene: &Path, _run: &Run<'_>) -> Result<Box<dyn Shot>, RendererError> {
        let given = std::path::absolute(scene).map_err(RendererError::io(scene))?;
        let own = self.folder().join(&self.file.scene);
        let scene = if given == self.path { own.clone() } else { given };
        if !scene.exists() {
            return Err(RendererError::MissingFile(scene.display().to_string()));
        }
        let file = &self.file;
        // Other scenes that a job names have other frames.
        let frames = if is_same(&scene, &own) { file.stated_frames() } else { None };
        let description = Description {
            frames: file.frames(),
            frames_per_second: file.frames_per_second,
            cameras: Vec::new(),
            layers: Vec::new(),
            objects: None,
            materials: None,
            settings: Settings { common: file.common(), own: file.own() },
            assets: Vec::new(),
            notes: Vec::new(),
            opening: Cost::default(),
        };
        Ok(Box::new(CommandShot::new(self.clone(), scene, frames, description)))
    }
}

/// Whether two paths lead to the same file.
fn is_same(one: &Path, other: &Path) -> bool {
    one == other || one.canonicalize().ok().zip(other.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}
