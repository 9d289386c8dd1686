//! Programs that are asked about themselves.

use super::lines::Line;
use super::messages::Message;
use super::program::Program;
use super::session::{Finished, run};
use crate::door::{Limits, RendererError, Run};
use forelight_kept::TemporaryFolder;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Time for a program to answer. Loading a large one from a cold disk takes a while.
const PATIENCE: Duration = Duration::from_secs(120);

/// Runs a program that says something about itself, such as its version, and ends. It gets an empty folder,
/// which is deleted afterwards. `on_line` gets what it says.
///
/// # Errors
/// Those of [`run`], if it takes longer than two minutes, and if there can be no folder.
pub fn ask(
    program: impl FnOnce(&Path) -> Program,
    known: &'static [Message],
    on_line: &mut dyn FnMut(&Line),
) -> Result<Finished, RendererError> {
    let folder = TemporaryFolder::new().map_err(RendererError::io(std::env::temp_dir()))?;
    let limits = Limits { time: Some(PATIENCE), ..Limits::default() };
    let cancelled = AtomicBool::new(false);
    run(&program(folder.path()), known, &Run::silent(&cancelled, folder.path(), limits), on_line)
}
