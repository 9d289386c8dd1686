//! Writes images where their jobs want them: below the output root, on storage that the studio shares.
//!
//! The images are artefacts first, so a frame never waits for this. A file appears under its name only when
//! it is whole. Files and folders have the root's own permissions, since others read them, and the rest of the
//! service writes for itself alone. Paths are opened through the root's own handle, so neither `..` nor a symbolic link leads out
//! of it.

use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use cap_std::ambient_authority;
use cap_std::fs::{Dir, Permissions, PermissionsExt as _};
use forelight_store::DueOutput;
use futures::TryStreamExt as _;

use crate::service::ServiceError;
use crate::state::App;

/// Pause before images that could not be written are tried again.
const AFTER_FAILURE: Duration = Duration::from_secs(10);

/// Images that are looked up at a time.
const AT_ONCE: u32 = 100;

/// The folder below which images are written.
#[derive(Clone, Debug)]
pub(crate) struct OutputRoot(Arc<Dir>);

impl OutputRoot {
    /// Opens the folder, which must exist.
    pub fn open(path: &Path) -> Result<Self, ServiceError> {
        let opened = Dir::open_ambient_dir(path, ambient_authority());
        let failed = |source| ServiceError::OutputRoot { path: path.display().to_string(), source };
        opened.map(|dir| Self(Arc::new(dir))).map_err(failed)
    }

    /// Writes a file, and puts it under its name once it is on disk.
    async fn write(&self, output: &DueOutput, pieces: Vec<Bytes>) -> io::Result<()> {
        let (root, path) = (self.0.clone(), PathBuf::from(&output.path));
        let unfinished = format!(".{}.unfinished", output.content);
        let written = tokio::task::spawn_blocking(move || write(&root, &path, &unfinished, &pieces)).await;
        written.map_err(io::Error::other)?
    }
}

fn write(root: &Dir, path: &Path, unfinished: &str, pieces: &[Bytes]) -> io::Result<()> {
    let folder = path.parent().map_or_else(PathBuf::new, Path::to_owned);
    let mode = root.dir_metadata()?.permissions().mode();
    make_folders(root, &folder, mode)?;
    let unfinished = folder.join(unfinished);
    let whole = (|| {
        let mut file = root.create(&unfinished)?;
        pieces.iter().try_for_each(|piece| file.write_all(piece))?;
        file.set_permissions(Permissions::from_mode(mode & 0o666))?;
        file.sync_all()?;
        root.rename(&unfinished, root, path)
    })();
    if whole.is_err() {
        // What is left of it would be in the way.
        let _ = root.remove_file(&unfinished);
    }
    whole
}

/// Makes a folder and those that it is in, as far as they are missing, with these permissions.
fn make_folders(root: &Dir, folder: &Path, mode: u32) -> io::Result<()> {
    let mut above: Vec<&Path> = folder.ancestors().filter(|path| !path.as_os_str().is_empty()).collect();
    above.reverse();
    for path in above {
        match root.create_dir(path) {
            Ok(()) => root.set_permissions(path, Permissions::from_mode(mode & 0o7777))?,
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Writes the images of finished frames until the service stops.
pub(crate) async fn write_outputs(app: &App) {
    let Some(root) = &app.output_root else { return };
    let mut events = app.store.watch_events();
    loop {
        events.borrow_and_update();
        let all_written = match app.store.due_outputs(AT_ONCE).await {
            Ok(due) if due.is_empty() => true,
            Ok(due) => {
                // What failed comes last from now on, so whatever else is due has its turn.
                if write_all(app, root, &due).await > 0 {
                    continue;
                }
                false
            }
            Err(error) => {
                tracing::warn!(%error, "images to be written could not be read; trying again soon");
                false
            }
        };
        tokio::select! {
            () = app.stopping.cancelled() => return,
            () = tokio::time::sleep(AFTER_FAILURE), if !all_written => {}
            changed = events.changed(), if all_written => if changed.is_err() { return },
        }
    }
}

/// Writes these images. Returns how many were written.
async fn write_all(app: &App, root: &OutputRoot, due: &[DueOutput]) -> usize {
    let mut written = 0;
    for output in due {
        if app.stopping.is_cancelled() {
            return 0;
        }
        let error = write_one(app, root, output).await.err();
        if let Some(error) = &error {
            tracing::warn!(job = %output.job, frame = output.frame, path = output.path, error, "image not written");
        }
        match app.store.note_output(output, error.as_deref(), app.now()).await {
            Ok(()) => written += usize::from(error.is_none()),
            Err(error) => tracing::warn!(%error, "the service could not note that an image was written"),
        }
    }
    written
}

async fn write_one(app: &App, root: &OutputRoot, output: &DueOutput) -> Result<(), String> {
    let read = async {
        let reader = app.store.artifacts().get(output.content, app.now()).await?;
        reader.whole().try_collect::<Vec<Bytes>>().await
    };
    let pieces = read.await.map_err(|error| format!("the image cannot be read: {error}"))?;
    let written = root.write(output, pieces).await;
    written.map_err(|error| format!("{}: {error}", output.path))
}
