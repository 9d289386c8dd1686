//! A file of ambient values: indirect light at places of the scene, which pixels share.
//!
//! rtrace reads the values in it when it starts, and adds those that it gathers. Processes on one file see
//! each other's values: Radiance locks it.

use forelight_renderer::door::RendererError;
use forelight_renderer::read_written;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// A file of ambient values, which is removed with this.
#[derive(Debug)]
pub(crate) struct Ambient {
    folder: TempDir,
}

impl Ambient {
    /// A file in `scratch` that does not exist yet.
    pub fn new(scratch: &Path) -> Result<Self, RendererError> {
        let folder = tempfile::Builder::new().prefix("ambient-").tempdir_in(scratch);
        Ok(Self { folder: folder.map_err(RendererError::io(scratch))? })
    }

    /// A file with these values, which rtrace wrote before.
    pub fn with(scratch: &Path, values: &[u8]) -> Result<Self, RendererError> {
        let new = Self::new(scratch)?;
        let path = new.path();
        fs::write(&path, values).map_err(RendererError::io(&path))?;
        Ok(new)
    }

    fn path(&self) -> std::path::PathBuf {
        self.folder.path().join("values.amb")
    }

    /// Arguments of rtrace that name the file.
    pub fn arguments(&self) -> [String; 2] {
        ["-af".to_owned(), self.path().display().to_string()]
    }

    /// The values in it. Commands of a scene could put a link in its place.
    pub fn read(&self) -> Result<Vec<u8>, RendererError> {
        read_written(&self.path())
    }
}
