//! Writes images where their jobs want them: below the output root. The images are artefacts first, so a frame
//! never waits for this.

use std::time::Duration;

use bytes::Bytes;
use forelight_store::DueOutput;
use futures::TryStreamExt as _;

use crate::output_root::OutputRoot;
use crate::state::App;

/// Pause before images that could not be written are tried again.
const AFTER_FAILURE: Duration = Duration::from_secs(10);

/// Images that are looked up at a time.
const AT_ONCE: u32 = 100;

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
