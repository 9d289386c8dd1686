//! What an agent asks of whoever does the work: a task in, a result and its files out.

use bytes::Bytes;
use forelight_protocol::{TaskResult, TaskSpec};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// A task with everything that it needs on this machine.
#[derive(Debug, Clone)]
pub struct Assignment {
    /// What to do.
    pub spec: TaskSpec,
    /// Where the bundle lies.
    pub bundle: PathBuf,
    /// The profile whose pixels are to be taken over, if the task names one.
    pub profile: Option<Bytes>,
}

/// What came of a task.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The result, which names artefacts by their hash.
    pub result: TaskResult,
    /// These artefacts.
    pub artifacts: Vec<Bytes>,
}

/// Why nothing came of a task.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ExecuteError {
    /// It was told to stop.
    #[error("stopped")]
    Cancelled,
    /// The task cannot be done, by anyone.
    #[error("{0}")]
    Permanent(String),
    /// It went wrong here and now.
    #[error("{0}")]
    Transient(String),
}

/// Progress and the order to stop, shared between the thread that works and the task that talks to the service.
#[derive(Debug, Default)]
pub struct Control {
    progress: AtomicU64,
    cancelled: AtomicBool,
}

impl Control {
    /// Says how far the work is, 0 to 1.
    pub fn set_progress(&self, fraction: f64) {
        let fraction = if fraction.is_finite() { fraction.clamp(0.0, 1.0) } else { 0.0 };
        self.progress.store(fraction.to_bits(), Ordering::Relaxed);
    }

    /// How far the work is, 0 to 1.
    pub fn progress(&self) -> f64 {
        f64::from_bits(self.progress.load(Ordering::Relaxed))
    }

    /// Orders the work to stop.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Whether the work was ordered to stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// The order to stop, as renderers take it.
    pub fn cancelled(&self) -> &AtomicBool {
        &self.cancelled
    }
}

/// Does tasks. Called on a thread pool that it may use all of; looks at `control` often.
pub trait Execute: Send + Sync + 'static {
    /// Does one task.
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError>;
}
