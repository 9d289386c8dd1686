//! What is started.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf, absolute};
use std::process::Command;

/// A program with its arguments and environment.
#[derive(Debug, Clone)]
pub struct Program {
    path: PathBuf,
    arguments: Vec<OsString>,
    environment: Vec<(OsString, OsString)>,
    folder: PathBuf,
    home: PathBuf,
    is_connected: bool,
}

impl Program {
    /// The program at `path`, from the folder of this process on, or of this name in `PATH`. It is run in
    /// `folder`, which is its home and its folder for temporary files. `PATH` is passed on to it.
    pub fn new(path: impl Into<PathBuf>, folder: &Path) -> Self {
        let path = path.into();
        let is_name = path.components().count() == 1;
        let program = Self {
            path: if is_name { path } else { absolute(&path).unwrap_or(path) },
            arguments: Vec::new(),
            environment: vec![("LANG".into(), "C.UTF-8".into())],
            folder: folder.into(),
            home: folder.into(),
            is_connected: false,
        };
        program.pass_on("PATH")
    }

    /// Another home and folder for temporary files than the folder in which it is run.
    #[must_use]
    pub fn at_home(mut self, home: &Path) -> Self {
        self.home = home.into();
        self
    }

    /// Leaves it the network in a [`Sandbox`](super::Sandbox): it asks a licence server, for example.
    #[must_use]
    pub fn connected(mut self) -> Self {
        self.is_connected = true;
        self
    }

    /// Adds an argument.
    #[must_use]
    pub fn arg(mut self, argument: impl Into<OsString>) -> Self {
        self.arguments.push(argument.into());
        self
    }

    /// Adds arguments.
    #[must_use]
    pub fn args<A: Into<OsString>>(mut self, arguments: impl IntoIterator<Item = A>) -> Self {
        self.arguments.extend(arguments.into_iter().map(Into::into));
        self
    }

    /// Sets a variable of its environment.
    #[must_use]
    pub fn env(mut self, name: impl Into<OsString>, value: impl Into<OsString>) -> Self {
        self.environment.push((name.into(), value.into()));
        self
    }

    /// Passes on a variable of this process, if it is set.
    #[must_use]
    pub fn pass_on(self, name: impl AsRef<OsStr>) -> Self {
        match std::env::var_os(&name) {
            Some(value) => self.env(name.as_ref(), value),
            None => self,
        }
    }

    /// Path of the program.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Name of the program, for messages.
    pub fn name(&self) -> String {
        self.path.file_name().unwrap_or(self.path.as_os_str()).to_string_lossy().into_owned()
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn home(&self) -> &Path {
        &self.home
    }

    pub(super) fn is_connected(&self) -> bool {
        self.is_connected
    }

    /// The command, without its streams and group.
    pub(super) fn command(&self) -> Command {
        let mut command = Command::new(&self.path);
        command.args(&self.arguments).env_clear().current_dir(&self.folder);
        command.env("HOME", &self.home).env("TMPDIR", &self.home);
        command.envs(self.environment.iter().map(|(name, value)| (name, value)));
        command
    }
}
