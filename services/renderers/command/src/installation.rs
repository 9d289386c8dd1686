//! Finds the program that a file describes.

use crate::file::CommandFile;
use forelight_renderer::door::{Renderer as _, RendererError, RendererId, Settings};
use forelight_renderer::process::{Program, ask};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// End of the name of such a file.
pub const EXTENSION: &str = ".command.toml";

/// A renderer that one can only start, as its file describes it.
#[derive(Debug, Clone)]
pub struct CommandRenderer {
    pub(crate) id: RendererId,
    pub(crate) file: Arc<CommandFile>,
    /// Absolute path of the file.
    pub(crate) path: PathBuf,
    /// Path of the program.
    pub(crate) program: PathBuf,
}

/// Reads the file of a renderer, looks for its program, and asks for its version.
///
/// # Errors
/// If the file cannot be read or something in it is wrong: names the file, the line and the reason. If the
/// program is not on this machine, or does not say its version.
pub fn open_command(path: &Path) -> Result<CommandRenderer, RendererError> {
    let path = std::path::absolute(path).map_err(RendererError::io(path))?;
    let file = CommandFile::read(&path)?;
    let first = file.arguments.0[0].get_ref().fill(&Default::default());
    let program = find(&first, &path, &file.name)?;
    let version = match (&file.version, &file.version_command) {
        (Some(version), _) => version.clone(),
        (None, command) => {
            let command = command.as_ref().map_or(&[][..], |command| &command.0);
            version(&file, command, &path)?
        }
    };
    let id = RendererId { name: file.name.clone(), version };
    id.check().map_err(|(field, reason)| RendererError::Scene {
        scene: path.clone(),
        reason: format!("{field}: {reason}; `version` or `version_pattern` can say the version"),
    })?;
    let renderer = CommandRenderer { id, file: Arc::new(file), path, program };
    let own = Settings { common: renderer.file.common(), own: renderer.file.own() };
    own.check(&renderer.settings_schema()).map_err(|wrong| RendererError::Scene {
        scene: renderer.path.clone(),
        reason: format!("defaults: {wrong}"),
    })?;
    Ok(renderer)
}

/// The program: a path, from the file's folder on, or a name that is looked for in `PATH`.
fn find(program: &str, file: &Path, name: &str) -> Result<PathBuf, RendererError> {
    let not_installed = |reason: String| RendererError::NotInstalled {
        renderer: name.to_owned(),
        reason: format!("{}: arguments: {reason}", file.display()),
    };
    if program.contains('/') {
        let path = file.parent().unwrap_or(Path::new("/")).join(program);
        return if path.is_file() {
            Ok(path)
        } else {
            Err(not_installed(format!("{} is no file", path.display())))
        };
    }
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let mut paths = std::env::split_paths(&folders).map(|folder| folder.join(program));
    paths
        .find(|path| path.is_file())
        .ok_or_else(|| not_installed(format!("no program `{program}` in PATH; install it, or name its path")))
}

/// The first line that matches the pattern, or else the first line.
fn version(file: &CommandFile, command: &[String], path: &Path) -> Result<String, RendererError> {
    let first = command.first().map_or("", String::as_str);
    let found = find(first, path, &file.name)?;
    let program = |folder: &Path| {
        let program = Program::new(found, folder).args(&command[1..]);
        file.pass_on.iter().fold(program, |program, name| program.pass_on(name))
    };
    let mut version = None;
    let result = ask(program, &[], &mut |line| {
        let found = match &file.version_pattern {
            Some(pattern) => pattern.find(&line.text),
            None => Some(line.text.trim()),
        };
        if version.is_none() {
            version = found.filter(|text| !text.is_empty()).map(str::to_owned);
        }
    });
    match (version, result) {
        // Some programs print their version and return an error.
        (Some(version), Ok(_) | Err(RendererError::Ended { .. })) => Ok(version),
        (_, Err(error)) => Err(error),
        (None, Ok(_)) => Err(RendererError::Scene {
            scene: path.to_owned(),
            reason: "version_command: the program printed no version".to_owned(),
        }),
    }
}

impl CommandRenderer {
    /// Folder of its file.
    pub(crate) fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new("/"))
    }
}
