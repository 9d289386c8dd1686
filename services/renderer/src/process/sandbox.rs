//! A namespace of its own for a foreign program, by bubblewrap (`bwrap`).
//!
//! In it a program reads what the worker can read, less what is hidden. It writes only the folder of the
//! tasks and its own home, sees no process but its own, and reaches no network. `bwrap` stays between this
//! process and the program: it hands the exit code on, but no signal.

use super::program::Program;
use crate::door::RendererError;
use forelight_kept::TemporaryFolder;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Name of bubblewrap's program, which Debian's package `bubblewrap` has.
const BWRAP: &str = "bwrap";

/// Devices of graphics cards, by the beginnings of their names in `/dev`.
const GRAPHICS: [&str; 3] = ["dri", "kfd", "nvidia"];

/// Where other services of the machine listen: a read-only folder does not keep programs from asking them.
const SERVICES: [&str; 8] = [
    "/tmp/.X11-unix",
    "/run/user",
    "/run/dbus",
    "/run/docker.sock",
    "/run/containerd",
    "/run/podman",
    "/run/libvirt",
    "/run/systemd/private",
];

/// The variable with the socket that signs with the user's keys.
const KEYS: &str = "SSH_AUTH_SOCK";

/// What the programs of a worker may write and may not read.
#[derive(Debug)]
pub struct Sandbox {
    folder: TemporaryFolder,
    hidden: Vec<PathBuf>,
}

impl Sandbox {
    /// Tries bubblewrap on this machine. Programs will not be able to read the `hidden` files and folders.
    ///
    /// # Errors
    /// [`RendererError::NotInstalled`], if there is no `bwrap`, or the system lets it make no namespace.
    pub fn new(hidden: Vec<PathBuf>) -> Result<Self, RendererError> {
        let temporary = std::env::temp_dir();
        let folder = TemporaryFolder::new().map_err(RendererError::io(temporary))?;
        let sandbox = Self { folder, hidden };
        let program = Program::new("true", sandbox.folder.path());
        let unusable = |reason: String| RendererError::NotInstalled {
            renderer: "bubblewrap".to_owned(),
            reason: format!("{reason}; install the package bubblewrap, or leave out --sandbox"),
        };
        let tried = sandbox.command(&program).output();
        let tried = tried.map_err(|error| unusable(format!("{BWRAP} cannot be started: {error}")))?;
        if tried.status.success() {
            return Ok(sandbox);
        }
        let said = String::from_utf8_lossy(&tried.stderr);
        Err(unusable(said.lines().next().unwrap_or("it ended with an error").to_owned()))
    }

    /// The folder that programs may write, besides their homes. It is removed at the end.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The program inside of the sandbox. Environment and folder are those of the program.
    pub(super) fn command(&self, program: &Program) -> Command {
        let inner = program.command();
        let mut bwrap = Command::new(BWRAP);
        bwrap.env_clear().envs(inner.get_envs().filter_map(|(name, value)| Some((name, value?))));
        // As the first process of its namespace, the program is waited for by `bwrap` itself: otherwise what it
        // used would be lost.
        bwrap.args(["--die-with-parent", "--as-pid-1", "--cap-drop", "ALL"]);
        bwrap.args(["--unshare-user", "--unshare-pid", "--unshare-ipc", "--unshare-uts"]);
        if !program.is_connected() {
            bwrap.arg("--unshare-net");
        }
        bwrap.args(["--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc"]);
        for device in graphics() {
            bwrap.arg("--dev-bind").args([&device, &device]);
        }
        let keys = std::env::var_os(KEYS).map(PathBuf::from);
        let hidden = SERVICES.iter().map(PathBuf::from).chain(keys).chain(self.hidden.iter().cloned());
        // Those that do not exist yet are hidden from the programs that start later.
        for hidden in hidden.filter_map(|hidden| hidden.canonicalize().ok()) {
            match hidden.is_dir() {
                true => bwrap.arg("--tmpfs").arg(hidden),
                false => bwrap.args(["--ro-bind", "/dev/null"]).arg(hidden),
            };
        }
        for writable in [self.folder.path(), program.home()] {
            bwrap.arg("--bind").args([writable, writable]);
        }
        let folder = std::path::absolute(program.folder()).unwrap_or_else(|_| program.folder().to_owned());
        bwrap.arg("--chdir").arg(folder).arg("--");
        bwrap.arg(inner.get_program()).args(inner.get_args());
        bwrap
    }
}

fn graphics() -> impl Iterator<Item = PathBuf> {
    let devices = std::fs::read_dir("/dev").into_iter().flatten().flatten().map(|entry| entry.path());
    devices.filter(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        GRAPHICS.iter().any(|graphics| name.starts_with(graphics))
    })
}
