//! Pictures of a video, fetched from the service to a folder of their task.

use forelight_client::{Client, ClientError};
use forelight_protocol::ArtifactHash;
use forelight_renderer::{Control, FETCHED, picture_name};
use futures::{StreamExt as _, TryStreamExt as _};
use std::path::Path;

/// Pictures that are fetched at the same time.
const AT_ONCE: usize = 4;

/// Fetches the pictures that are not in the folder yet, and reports progress.
pub(crate) async fn fetch(
    client: &Client,
    pictures: &[ArtifactHash],
    folder: &Path,
    control: &Control,
) -> Result<(), ClientError> {
    let wanted = pictures.iter().copied().enumerate();
    let fetched = futures::stream::iter(wanted).map(|(place, hash)| {
        let (client, path) = (client.clone(), folder.join(picture_name(place)));
        async move {
            if !path.exists() {
                // A picture under its own name is whole.
                let partial = path.with_extension("part");
                client.artifact_to_file(hash, &partial).await?;
                let renamed = tokio::fs::rename(&partial, &path).await;
                renamed.map_err(|source| ClientError::File { path, source })?;
            }
            Ok(())
        }
    });
    let mut fetched = fetched.buffer_unordered(AT_ONCE).enumerate().map(|(done, one)| one.map(|()| done + 1));
    while let Some(done) = fetched.try_next().await? {
        control.set_progress(FETCHED * done as f64 / pictures.len() as f64);
    }
    Ok(())
}
