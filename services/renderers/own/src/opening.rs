//! Our renderer, over `scene`, `preview` and `tracer`.

use crate::error::RenderError;
use crate::shot::OwnShot;
use forelight_kept::Folder;
use forelight_preview::{Choice, PreviewError, SharedPreviewer};
use forelight_protocol::RendererId;
use forelight_scene::Limits;
use forelight_tracer::tracer_version;
use std::path::Path;
use std::sync::Arc;

/// Opens bundles with our renderer. They share one previewer, as a process has one graphics device.
#[derive(Clone)]
pub struct OwnRenderer {
    previewer: Arc<SharedPreviewer>,
    limits: Limits,
    kept: Option<Folder>,
}

/// A graphics device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adapter {
    /// Name, kind and driver.
    pub name: String,
    /// Whether it is a graphics processor rather than software.
    pub is_hardware: bool,
}

impl OwnRenderer {
    /// A renderer that makes previews as `choice` says.
    pub fn new(choice: Choice) -> Self {
        Self { previewer: Arc::new(SharedPreviewer::new(choice)), limits: Limits::default(), kept: None }
    }

    /// Its name and version.
    pub fn id() -> RendererId {
        RendererId::own(tracer_version())
    }

    /// Keeps loaded scenes and trees in a folder, and takes them from there.
    #[must_use]
    pub fn keeping(self, folder: Folder) -> Self {
        Self { kept: Some(folder), ..self }
    }

    /// The graphics device for previews. `None` if previews are made on the CPU.
    pub fn adapter(&self) -> Result<Option<Adapter>, PreviewError> {
        self.previewer.with(|previewer| {
            let adapter =
                |name: &str| Adapter { name: name.to_owned(), is_hardware: previewer.is_hardware() };
            Ok(previewer.adapter().map(adapter))
        })
    }

    /// What makes its previews, for other renderers of this process.
    pub fn previewer(&self) -> Arc<SharedPreviewer> {
        self.previewer.clone()
    }

    /// Opens a bundle.
    pub fn open(&self, path: &Path) -> Result<OwnShot, RenderError> {
        OwnShot::open(path, &self.limits, self.previewer.clone(), self.kept.clone())
    }
}
