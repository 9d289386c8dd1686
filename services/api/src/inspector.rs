//! Loads bundles, in a process of its own if the service has a program for it.
//!
//! Hazard: a bundle can be made to take all memory, to take for ever, or to make a parser panic. In a process
//! that is held to limits, that harms the request that brought it and nothing else. A process may also hang on
//! a file server that is gone, where nothing can end it. Then it is given up.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use forelight_protocol::{ProblemKind, SceneSummary};
use forelight_renderer::door::{Limits as ProcessLimits, RendererError, Run};
use forelight_renderer::process::{Program, Stream, run};
use forelight_renderer::summary;
use forelight_scene::{Limits, Scene, SceneError};
use parking_lot::Mutex;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::error::{ApiError, ApiResult};

/// How bundles are loaded.
#[derive(Clone, Debug)]
pub struct Inspection {
    /// A program that is started as `PROGRAM inspect-bundle LIMITS BUNDLE` and prints [`inspect_bundle`]'s
    /// answer as JSON. Default: none; bundles are loaded in this process.
    pub program: Option<PathBuf>,
    /// Memory that loading a bundle may take, bytes. Only with a program. Default: 8 GiB.
    pub memory_bytes: u64,
    /// Time that loading a bundle may take. Default: 5 min.
    pub time: Duration,
}

impl Default for Inspection {
    fn default() -> Self {
        Self { program: None, memory_bytes: 8 << 30, time: Duration::from_secs(300) }
    }
}

/// What is found in a bundle, or why it is none.
type Found = Result<SceneSummary, String>;

/// Loads and describes a bundle, for a process that does nothing else. The inner error says why it is none.
///
/// # Errors
/// If `limits` is not JSON as the service writes it.
pub fn inspect_bundle(
    limits: &str,
    bundle: &Path,
) -> Result<Result<SceneSummary, String>, serde_json::Error> {
    let limits: Limits = serde_json::from_str(limits)?;
    Ok(load(bundle, &limits).map_err(|error| error.to_string()))
}

fn load(path: &Path, limits: &Limits) -> Result<SceneSummary, SceneError> {
    let scene = Scene::load(path, limits)?;
    Ok(summary(&scene, &scene.frame(0)?))
}

/// Loads bundles, few at a time: each needs a core and memory.
pub(crate) struct Inspector {
    inspection: Inspection,
    limits: Limits,
    turns: Arc<Semaphore>,
}

/// Time beyond the limit after which a process that cannot be ended is given up.
const GIVEN_UP_AFTER: Duration = Duration::from_secs(10);

/// Stops a process whose request is gone.
struct Stop(Arc<AtomicBool>);

impl Drop for Stop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Inspector {
    pub fn new(inspection: Inspection, limits: Limits, at_once: usize) -> Self {
        Self { inspection, limits, turns: Arc::new(Semaphore::new(at_once.max(1))) }
    }

    /// Loads a bundle. The error of a bad one calls it by its path.
    pub async fn inspect(&self, path: PathBuf) -> ApiResult<Found> {
        let stopped = |_| ApiError::new(ProblemKind::Busy, "the service is stopping");
        let turn = self.turns.clone().acquire_owned().await.map_err(stopped)?;
        // The turn ends with the work, also if nobody waits for it any more; or when the work is given up.
        let turn: Arc<Mutex<Option<OwnedSemaphorePermit>>> = Arc::new(Mutex::new(Some(turn)));
        let stop = Stop(Arc::default());
        let (inspection, limits, cancelled) = (self.inspection.clone(), self.limits, stop.0.clone());
        let (time, held) = (inspection.time, turn.clone());
        let shown = path.display().to_string();
        let work = tokio::task::spawn_blocking(move || {
            let found = match &inspection.program {
                Some(program) => inspect_outside(program, &path, &limits, &inspection, &cancelled),
                None => Ok(load(&path, &limits).map_err(|error| error.to_string())),
            };
            drop(held.lock().take());
            found
        });
        match tokio::time::timeout(time + GIVEN_UP_AFTER, work).await {
            Ok(Ok(found)) => found,
            Ok(Err(error)) => {
                tracing::error!(%error, bundle = shown, "loading a bundle panicked");
                Ok(Err(format!("{shown}: the scene loader failed on it; the service's log has the cause")))
            }
            Err(_) => {
                tracing::error!(bundle = shown, "loading a bundle hangs; it is given up");
                drop(turn.lock().take());
                Ok(Err(too_slow(&shown, time)))
            }
        }
    }
}

fn too_slow(bundle: &str, time: Duration) -> String {
    format!("{bundle}: it takes more than {} s to load", time.as_secs())
}

/// Has a program load the bundle, held to limits.
fn inspect_outside(
    program: &Path,
    bundle: &Path,
    limits: &Limits,
    inspection: &Inspection,
    cancelled: &AtomicBool,
) -> ApiResult<Found> {
    let failed = |error: &dyn std::fmt::Display| {
        tracing::error!(%error, bundle = %bundle.display(), "a bundle could not be inspected");
        let reason = "the bundle could not be inspected; the service's log has the cause";
        ApiError::new(ProblemKind::Internal, reason)
    };
    let limits = serde_json::to_string(limits).map_err(|error| failed(&error))?;
    let path = std::path::absolute(bundle).map_err(|error| failed(&error))?;
    let scratch = std::env::temp_dir();
    let program = Program::new(program, &scratch).arg("inspect-bundle").arg(limits).arg(&path);
    let run_limits = ProcessLimits {
        memory_bytes: Some(inspection.memory_bytes),
        time: Some(inspection.time),
        grace: Duration::ZERO,
        ..ProcessLimits::default()
    };
    let log = |line: &str| tracing::debug!(line, "inspecting a bundle");
    let outside = Run { log: &log, ..Run::silent(cancelled, &scratch, run_limits) };
    let mut answer = String::new();
    let ended = run(&program, &[], &outside, &mut |line| {
        if line.stream == Stream::Out {
            answer += &line.text;
        }
    });
    let shown = bundle.display().to_string();
    match ended {
        Ok(_) => {
            let found: Found = serde_json::from_str(&answer).map_err(|error| failed(&error))?;
            Ok(found.map_err(|reason| reason.replace(&path.display().to_string(), &shown)))
        }
        Err(RendererError::OutOfMemory(_)) => {
            let mib = inspection.memory_bytes >> 20;
            Ok(Err(format!("{shown}: it takes more than {mib} MiB of memory to load")))
        }
        Err(RendererError::TimeLimit(time)) => Ok(Err(too_slow(&shown, time))),
        Err(error @ RendererError::Ended { .. }) => {
            tracing::error!(%error, bundle = shown, "loading a bundle failed");
            Ok(Err(format!("{shown}: the scene loader failed on it; the service's log has the cause")))
        }
        Err(error) => Err(failed(&error)),
    }
}
