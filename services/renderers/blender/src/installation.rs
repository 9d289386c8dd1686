//! Finds Blender, and starts it.

use forelight_preview::SharedPreviewer;
use forelight_renderer::door::{RendererError, RendererId};
use forelight_renderer::process::{Meaning, Message, Program, ask};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Variable with the path of a Python that has the module `bpy`.
const PYTHON: &str = "FORELIGHT_BPY_PYTHON";

/// The variable that names folders of libraries. Those of X and GL may be there.
const LIBRARIES: &str = "LD_LIBRARY_PATH";

/// Oldest version, and the first major version that is too new.
const OLDEST: (u32, u32) = (4, 2);
const TOO_NEW: u32 = 6;

/// Messages of Blender.
pub(crate) const MESSAGES: &[Message] = &[
    ("malloc returns null", Meaning::OutOfMemory),
    ("calloc returns null", Meaning::OutOfMemory),
    ("system is out of gpu memory", Meaning::Gpu),
];

/// Prints the version of the module, or says in one line that there is none.
const FIND_MODULE: &str = "import importlib.util\n\
    if importlib.util.find_spec('bpy') is None: raise SystemExit('it has no module bpy')\n\
    import bpy; print('Blender', bpy.app.version_string)";

/// How Blender is started.
#[derive(Debug, Clone)]
enum How {
    /// The program `blender`.
    Program(PathBuf),
    /// A Python with the module `bpy`.
    Module(PathBuf),
}

/// Blender Cycles on this machine.
#[derive(Clone)]
pub struct Cycles {
    pub(crate) id: RendererId,
    how: How,
    pub(crate) previewer: Arc<SharedPreviewer>,
}

impl Cycles {
    /// Finds Blender: the program `blender`, the Python that `FORELIGHT_BPY_PYTHON` names, `python3`. Draws previews
    /// with this previewer.
    ///
    /// # Errors
    /// If there is none, or none of a version from 4.2 to 5.x: says what was found.
    pub fn find(previewer: Arc<SharedPreviewer>) -> Result<Self, RendererError> {
        let named = std::env::var_os(PYTHON).map(|path| How::Module(path.into()));
        let ways = [Some(How::Program("blender".into())), named, Some(How::Module("python3".into()))];
        let mut reasons = Vec::new();
        for how in ways.into_iter().flatten() {
            match how.version() {
                Ok(version) if is_supported(&version) => {
                    let id = RendererId { name: "cycles".to_owned(), version };
                    return Ok(Self { id, how, previewer });
                }
                Ok(version) => reasons.push(format!("{how} is Blender {version}")),
                Err(error) => reasons.push(format!("{how}: {error}")),
            }
        }
        Err(RendererError::NotInstalled {
            renderer: "Blender from 4.2 to 5.x".to_owned(),
            reason: format!("{}; install it, or set {PYTHON} to a Python with bpy", reasons.join("; ")),
        })
    }

    /// The program that runs a driver script. It will render with this many threads.
    pub(crate) fn program(&self, driver: &Path, folder: &Path, threads: u32) -> Program {
        let (path, arguments): (_, &[&str]) = match &self.how {
            How::Program(path) => (
                path,
                &[
                    "--background",
                    "--factory-startup",
                    "--disable-autoexec",
                    "-noaudio",
                    "--python-exit-code",
                    "1",
                    "-P",
                ],
            ),
            How::Module(path) => (path, &["-I", "-B"]),
        };
        let program = Program::new(path, folder).pass_on(LIBRARIES);
        let program = match &self.how {
            How::Program(_) => program.arg("--threads").arg(threads.to_string()),
            How::Module(_) => program,
        };
        program.args(arguments).arg(driver)
    }
}

impl How {
    fn version(&self) -> Result<String, RendererError> {
        let program = |folder: &Path| match self {
            Self::Program(path) => Program::new(path, folder).args(["--background", "--version"]),
            Self::Module(path) => Program::new(path, folder).args(["-I", "-B", "-c", FIND_MODULE]),
        };
        let program = |folder: &Path| program(folder).pass_on(LIBRARIES);
        let mut version = None;
        ask(program, MESSAGES, &mut |line| {
            if let Some(rest) = line.text.strip_prefix("Blender ") {
                version = rest.split_whitespace().next().map(str::to_owned);
            }
        })?;
        version.ok_or_else(|| RendererError::Answer("no version".to_owned()))
    }
}

impl std::fmt::Display for How {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Program(path) => write!(f, "{}", path.display()),
            Self::Module(path) => write!(f, "bpy of {}", path.display()),
        }
    }
}

/// Whether the driver knows this version.
fn is_supported(version: &str) -> bool {
    let mut numbers = version.split('.').map_while(|number| number.parse().ok());
    matches!((numbers.next(), numbers.next()), (Some(major), Some(minor)) if (major, minor) >= OLDEST && major < TOO_NEW)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_from_4_2_to_5_x_are_supported() {
        for (version, supported) in [
            ("4.1.1", false),
            ("4.2.0", true),
            ("4.5.15", true),
            ("5.0.1", true),
            ("6.0.0", false),
            ("x", false),
        ] {
            assert_eq!(is_supported(version), supported, "{version}");
        }
    }
}
