//! Why a renderer has no answer.

use super::asset::Asset;
use super::settings::SettingsError;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// How a process ended that should not have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// It returned this code.
    Code(i32),
    /// This signal ended it.
    Signal(i32),
    /// It closed its input or output, went on, and had to be ended.
    Closed,
}

/// Why a renderer has no answer. Every variant says what happened and where.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RendererError {
    /// No such renderer on this machine.
    #[error("no {renderer} on this machine: {reason}")]
    NotInstalled {
        /// Name of the renderer.
        renderer: String,
        /// Where it was looked for, and what to do.
        reason: String,
    },
    /// The scene cannot be read.
    #[error("{}: {reason}", scene.display())]
    Scene {
        /// Path of the scene.
        scene: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The scene refers to files that do not exist.
    #[error("missing assets: {}", names(.0))]
    MissingAssets(Vec<Asset>),
    /// Files that the scene refers to cannot be inside it.
    #[error("cannot be packed into the scene: {}", names(.0))]
    NotPacked(Vec<Asset>),
    /// The renderer did not find a file.
    #[error("missing file: {0}")]
    MissingFile(String),
    /// A setting is wrong.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The renderer cannot do this.
    #[error("{0}")]
    Unsupported(String),
    /// An artefact cannot be taken over.
    #[error("{}: {reason}", path.display())]
    Artefact {
        /// The artefact's file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// Memory ran out, or the limit on it was exceeded.
    #[error("out of memory: {0}")]
    OutOfMemory(String),
    /// No licence.
    #[error("licence: {0}")]
    Licence(String),
    /// The GPU failed.
    #[error("GPU: {0}")]
    Gpu(String),
    /// The run exceeded its time.
    #[error("stopped at the time limit of {:.1} s", .0.as_secs_f64())]
    TimeLimit(Duration),
    /// The run was told to stop.
    #[error("stopped")]
    Cancelled,
    /// The process ended too early or with an error.
    #[error("{program} {}{}", ended(*.ending), last_words(.last_lines))]
    Ended {
        /// Name of the program.
        program: String,
        /// How it ended.
        ending: Ending,
        /// The last lines that it printed.
        last_lines: Vec<String>,
    },
    /// The renderer says that it failed.
    #[error("{0}")]
    Failed(String),
    /// The renderer's answer is not what was asked for.
    #[error("answer of the renderer not understood: {0}")]
    Answer(String),
    /// A program cannot be started, or a file not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The program or file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

impl RendererError {
    /// For `map_err`: an error of the system, with its file.
    pub fn io(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }

    /// The error of a program that failed with this one and had printed a message that tells of another. A
    /// program that crashes or is killed did not end because it misses a file, whatever it said before.
    #[must_use]
    pub fn explained_by(self, told: Self) -> Self {
        let was_killed = matches!(self, Self::Ended { ending: Ending::Signal(_), .. });
        if was_killed && told.is_permanent() { self } else { told }
    }

    /// Whether trying again with the same input, here or on a like machine, would give the same error.
    pub fn is_permanent(&self) -> bool {
        matches!(
            self,
            Self::Scene { .. }
                | Self::MissingAssets(_)
                | Self::NotPacked(_)
                | Self::MissingFile(_)
                | Self::Settings(_)
                | Self::Unsupported(_)
                | Self::Artefact { .. }
        )
    }
}

fn names(assets: &[Asset]) -> String {
    let names: Vec<String> = assets.iter().map(|a| format!("{} {} ({})", a.kind, a.name, a.path)).collect();
    names.join(", ")
}

fn ended(ending: Ending) -> String {
    match ending {
        Ending::Code(code) => format!("ended with exit code {code}"),
        Ending::Signal(signal) => format!("was ended by signal {signal}"),
        Ending::Closed => "closed its input or output and did not end".to_owned(),
    }
}

fn last_words(lines: &[String]) -> String {
    if lines.is_empty() { String::new() } else { format!("; its last lines: {}", lines.join(" | ")) }
}
