//! Finds Radiance, and starts its programs.

use crate::settings::defaults;
use forelight_renderer::door::{RendererError, RendererId};
use forelight_renderer::process::{Meaning, Message, Program, ask};
use serde_json::{Map, Value};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Variable with the folder of Radiance's programs.
const FOLDER: &str = "FORELIGHT_RADIANCE";

/// Radiance's own variable: where it looks for files.
const PATH_OF_FILES: &str = "RAYPATH";

/// A file that every installation has.
const LIBRARY_FILE: &str = "rayinit.cal";

/// Programs that are needed.
const PROGRAMS: [&str; 5] = ["rtrace", "vwrays", "oconv", "xform", "rad"];

/// Messages of Radiance.
pub(crate) const MESSAGES: &[Message] = &[
    ("cannot find", Meaning::MissingFile),
    ("cannot open", Meaning::MissingFile),
    ("bad/incompatible ambient file", Meaning::MissingFile),
];

/// Radiance on this machine.
#[derive(Debug, Clone)]
pub struct Radiance {
    pub(crate) id: RendererId,
    folder: PathBuf,
    /// Where it looks for files. `None`: where it was built to look.
    files: Option<OsString>,
    /// What rtrace does where neither scene nor job says anything.
    defaults: Map<String, Value>,
}

impl Radiance {
    /// Finds Radiance: in the folder that `FORELIGHT_RADIANCE` names, or else in `PATH`.
    ///
    /// # Errors
    /// If there is none, or a program of it is missing: says what was looked for.
    pub fn find() -> Result<Self, RendererError> {
        let not_installed =
            |reason: String| RendererError::NotInstalled { renderer: "Radiance".to_owned(), reason };
        let folder = match std::env::var_os(FOLDER) {
            Some(folder) => PathBuf::from(folder),
            None => {
                let path = std::env::var_os("PATH").unwrap_or_default();
                let mut folders = std::env::split_paths(&path);
                folders.find(|folder| folder.join(PROGRAMS[0]).is_file()).ok_or_else(|| {
                    let reason = format!(
                        "no program `{}` in PATH; install it, or set {FOLDER} to the folder of its programs",
                        PROGRAMS[0]
                    );
                    not_installed(reason)
                })?
            }
        };
        let folder = std::path::absolute(&folder).map_err(RendererError::io(&folder))?;
        if let Some(missing) = PROGRAMS.iter().find(|program| !folder.join(program).is_file()) {
            let reason = format!("no program `{missing}` in {}; install all of Radiance", folder.display());
            return Err(not_installed(reason));
        }
        let id = RendererId { name: "radiance".to_owned(), version: String::new() };
        let mut found = Self { id, files: files(&folder), folder, defaults: Map::new() };
        let said = found.lines_of("rtrace", &["-version"])?;
        found.id.version = version(&said.join(" "))
            .ok_or_else(|| not_installed(format!("rtrace -version says `{}`", said.join(" "))))?;
        found.defaults = defaults(&found.lines_of("rtrace", &["-defaults"])?);
        Ok(found)
    }

    /// What rtrace does where neither scene nor job says anything.
    pub(crate) fn defaults(&self) -> &Map<String, Value> {
        &self.defaults
    }

    /// One of Radiance's programs. It runs in the folder of a scene, because scenes name files relative to
    /// it; `home` is its home and its folder for temporary files.
    pub(crate) fn program(&self, name: &str, scene_folder: &Path, home: &Path) -> Program {
        let program = Program::new(self.folder.join(name), scene_folder).at_home(home);
        // Generators in scenes are programs of Radiance, too.
        let path = std::env::var_os("PATH").unwrap_or_default();
        let folders = std::iter::once(self.folder.clone()).chain(std::env::split_paths(&path));
        let program = match std::env::join_paths(folders) {
            Ok(path) => program.env("PATH", path),
            Err(_) => program,
        };
        match &self.files {
            Some(files) => program.env(PATH_OF_FILES, files),
            None => program,
        }
    }

    /// Where files of scenes are looked for, besides the scene's folder.
    pub(crate) fn folders_of_files(&self) -> Vec<PathBuf> {
        self.files.iter().flat_map(std::env::split_paths).filter(|folder| folder.is_absolute()).collect()
    }

    /// Whether it is known where Radiance looks for files.
    pub(crate) fn knows_folders(&self) -> bool {
        self.files.is_some()
    }

    fn lines_of(&self, program: &str, arguments: &[&str]) -> Result<Vec<String>, RendererError> {
        let program = |folder: &Path| self.program(program, folder, folder).args(arguments.iter().copied());
        let mut lines = Vec::new();
        ask(program, MESSAGES, &mut |line| lines.push(line.text.clone()))?;
        Ok(lines)
    }
}

/// Where Radiance looks for files: as `RAYPATH` says, or beside its programs.
fn files(programs: &Path) -> Option<OsString> {
    if let Some(stated) = std::env::var_os(PATH_OF_FILES) {
        return Some(stated);
    }
    let above = programs.parent()?;
    let libraries =
        ["lib", "share/radiance", "share/radiance/lib", "lib/radiance"].map(|name| above.join(name));
    let library = libraries.into_iter().find(|folder| folder.join(LIBRARY_FILE).is_file())?;
    std::env::join_paths([Path::new("."), &library]).ok()
}

/// `6.0a` of `RADIANCE 6.0a (official release)`. Characters that versions cannot have are left out.
fn version(text: &str) -> Option<String> {
    let word = text.split_once("RADIANCE")?.1.split_whitespace().next()?;
    let fits = |c: &char| c.is_ascii_alphanumeric() || "._+-".contains(*c);
    let version: String = word.chars().filter(fits).take(50).collect();
    (!version.is_empty()).then_some(version)
}

#[cfg(test)]
mod tests {
    use super::version;

    #[test]
    fn a_version_is_the_word_after_the_name() {
        for (text, expected) in [
            ("RADIANCE 6.0a (official release December 2024)", Some("6.0a")),
            ("RADIANCE 5.2 2018-07-20 LBNL", Some("5.2")),
            ("RADIANCE 5.4a/b", Some("5.4ab")),
            ("rtrace", None),
        ] {
            assert_eq!(version(text).as_deref(), expected, "{text}");
        }
    }
}
