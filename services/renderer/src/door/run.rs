//! What surrounds a question: orders, progress, log, limits and a folder.

use crate::process::Sandbox;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Limits of one run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Resident memory of all processes of the run together, bytes.
    pub memory_bytes: Option<u64>,
    /// Wall time.
    pub time: Option<Duration>,
    /// Threads that the renderer may use.
    pub threads: u32,
    /// Time between the request to end (SIGTERM) and the end by force (SIGKILL).
    pub grace: Duration,
}

impl Default for Limits {
    /// One thread, five seconds of grace, no other limit.
    fn default() -> Self {
        Self { memory_bytes: None, time: None, threads: 1, grace: Duration::from_secs(5) }
    }
}

/// Orders to stand still for a while.
pub trait Pause: Sync {
    /// Whether the work should stand still.
    fn is_wanted(&self) -> bool;

    /// Waits until the work may go on, or is told to stop.
    fn wait(&self);
}

/// One question to a renderer, as the renderer sees the outside.
#[derive(Clone, Copy)]
pub struct Run<'a> {
    /// Set to stop the run.
    pub cancelled: &'a AtomicBool,
    /// Has foreign programs stand still. `None`: nobody does.
    pub pause: Option<&'a dyn Pause>,
    /// Is told progress, 0 to 1.
    pub progress: &'a (dyn Fn(f64) + Sync),
    /// Is told every line that the renderer prints, as it comes.
    pub log: &'a (dyn Fn(&str) + Sync),
    /// Folder for files. Results stay in it; the renderer removes its temporary files.
    pub scratch: &'a Path,
    /// Limits to hold.
    pub limits: Limits,
    /// In which foreign programs run. `None`: with the rights of this process.
    pub sandbox: Option<&'a Sandbox>,
}

impl<'a> Run<'a> {
    /// A run that reports to nobody, without a sandbox.
    pub fn silent(cancelled: &'a AtomicBool, scratch: &'a Path, limits: Limits) -> Self {
        Self { cancelled, pause: None, progress: &|_| {}, log: &|_| {}, scratch, limits, sandbox: None }
    }

    /// Whether the run was told to stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}
