//! Questions to the driver, and its answers.

use crate::installation::{Cycles, MESSAGES};
use forelight_kept::TemporaryFolder;
use forelight_renderer::door::{RendererError, Run};
use forelight_renderer::process::{Session, Stream};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The scripts that run inside Blender. The first one is started.
const SCRIPTS: [(&str, &str); 6] = [
    ("driver.py", include_str!("driver/driver.py")),
    ("forelight_describe.py", include_str!("driver/forelight_describe.py")),
    ("forelight_errors.py", include_str!("driver/forelight_errors.py")),
    ("forelight_pack.py", include_str!("driver/forelight_pack.py")),
    ("forelight_render.py", include_str!("driver/forelight_render.py")),
    ("forelight_triangles.py", include_str!("driver/forelight_triangles.py")),
];

/// What begins a line of the driver.
const PREFIX: &str = "forelight ";

/// A Blender that has opened a file.
pub(crate) struct Connection {
    scene: PathBuf,
    session: Session,
    /// Home of the process, with the scripts. Removed with this.
    _folder: TemporaryFolder,
}

/// One line of the driver.
#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Said {
    Progress(f64),
    /// The file that holds the answer.
    Answer(PathBuf),
    Error {
        kind: String,
        message: String,
    },
}

impl Connection {
    /// Starts Blender, opens the file, and returns the driver's description of it.
    pub fn open<T: DeserializeOwned>(
        cycles: &Cycles,
        scene: &Path,
        run: &Run<'_>,
    ) -> Result<(Self, T), RendererError> {
        if !scene.is_file() {
            return Err(RendererError::MissingFile(scene.display().to_string()));
        }
        let scene = std::path::absolute(scene).map_err(RendererError::io(scene))?;
        let temporary = || RendererError::io(std::env::temp_dir());
        let folder = TemporaryFolder::new().map_err(temporary())?;
        for (name, text) in SCRIPTS {
            let path = folder.path().join(name);
            std::fs::write(&path, text).map_err(RendererError::io(&path))?;
        }
        let driver = folder.path().join(SCRIPTS[0].0);
        let program = cycles.program(&driver, folder.path(), run.limits.threads);
        let session = Session::start(&program, MESSAGES, run)?;
        let mut connection = Self { scene, session, _folder: folder };
        let question = json!({"do": "open", "scene": connection.scene, "threads": run.limits.threads});
        let description = connection.ask(&question, run)?;
        Ok((connection, description))
    }

    /// Whether Blender has ended.
    pub fn has_ended(&self) -> bool {
        self.session.has_ended()
    }

    /// Asks a question and waits for its answer. After any error but [`RendererError::Failed`] the
    /// connection should be dropped.
    pub fn ask<T: DeserializeOwned>(&mut self, question: &Value, run: &Run<'_>) -> Result<T, RendererError> {
        let since = Instant::now();
        self.session.hold_to(run);
        self.session.send(&question.to_string())?;
        loop {
            let Some(line) = self.session.next(since, run)? else { return Err(self.session.failure()) };
            let said = line.text.strip_prefix(PREFIX).filter(|_| line.stream == Stream::Out);
            let Some(said) = said else {
                (run.log)(&line.text);
                continue;
            };
            let misunderstood = |error: serde_json::Error| RendererError::Answer(error.to_string());
            match serde_json::from_str(said).map_err(misunderstood)? {
                Said::Progress(share) => (run.progress)(share),
                Said::Answer(file) => {
                    let text = std::fs::read(&file).map_err(RendererError::io(&file))?;
                    return serde_json::from_slice(&text).map_err(misunderstood);
                }
                Said::Error { kind, message } => return Err(self.error(&kind, message)),
            }
        }
    }

    fn error(&self, kind: &str, message: String) -> RendererError {
        match kind {
            "scene" => RendererError::Scene { scene: self.scene.clone(), reason: message },
            "out_of_memory" => RendererError::OutOfMemory(message),
            _ => RendererError::Failed(format!("{}: {message}", self.scene.display())),
        }
    }
}
