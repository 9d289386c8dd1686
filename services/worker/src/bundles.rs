//! Bundles fetched from the service: kept on disk by their hash.
//!
//! All workers of a process share one folder, so that a bundle is fetched once. Each task verifies the file's
//! hash before it is opened: a damaged one is fetched again. The folder is its user's alone.

use forelight_client::{Client, ClientError};
use forelight_kept::{Folder, TemporaryFolder, remove_abandoned};
use forelight_protocol::{ArtifactHash, BundleSource};
use std::fs;
use std::path::{Path, PathBuf};

/// Fetched bundles are deleted, least recently used first, when they exceed this many bytes.
const DISK_BYTES: u64 = 16 << 30;

/// A folder of fetched bundles.
#[derive(Debug)]
pub struct Bundles {
    folder: Folder,
    fetching: tokio::sync::Mutex<()>,
}

impl Bundles {
    /// Keeps bundles in `folder`. If it does not exist, it is created, for this user alone.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn new(folder: &Path) -> Result<Self, std::io::Error> {
        let folder = Folder::new(folder)?;
        remove_abandoned(folder.path());
        Ok(Self { folder, fetching: tokio::sync::Mutex::default() })
    }

    /// A folder for the pictures of one task, removed when it is dropped.
    pub(crate) fn folder_for_pictures(&self) -> Result<TemporaryFolder, std::io::Error> {
        TemporaryFolder::new_in(self.folder.path())
    }

    /// Path of a task's bundle on this machine. Fetches the bundle if needed.
    pub async fn locate(&self, client: &Client, source: &BundleSource) -> Result<PathBuf, ClientError> {
        let hash = match source {
            BundleSource::Path(path) => return Ok(path.into()),
            BundleSource::Artifact(hash) => *hash,
        };
        let _one_at_a_time = self.fetching.lock().await;
        let path = self.folder.path().join(format!("{hash}.zip"));
        let failed = |source| ClientError::File { path: path.clone(), source };
        if is_whole(&path, hash).await {
            forelight_kept::used(&path);
            return Ok(path);
        }
        let partial = tempfile::Builder::new()
            .prefix(forelight_kept::UNFINISHED)
            .tempfile_in(self.folder.path())
            .map_err(failed)?
            .into_temp_path();
        match client.artifact_to_file(hash, &partial).await {
            Err(ClientError::File { source, .. }) if is_full(&source) => {
                tracing::warn!(%source, "the disk is full: all other kept bundles are deleted");
                self.folder.make_room("zip", &path, 0);
                client.artifact_to_file(hash, &partial).await?;
            }
            fetched => fetched?,
        }
        partial.persist(&path).map_err(|error| failed(error.error))?;
        self.folder.make_room("zip", &path, DISK_BYTES);
        Ok(path)
    }
}

/// Whether there is no space left, or none for this user.
fn is_full(error: &std::io::Error) -> bool {
    matches!(error.kind(), std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded)
}

/// Whether a file is there and has the hash that it is named by.
async fn is_whole(path: &Path, hash: ArtifactHash) -> bool {
    let kept = path.to_owned();
    let found = tokio::task::spawn_blocking(move || {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(fs::File::open(kept)?)?;
        Ok::<_, std::io::Error>(ArtifactHash(*hasher.finalize().as_bytes()))
    });
    match found.await {
        Ok(Ok(found)) if found == hash => true,
        Ok(Ok(found)) => {
            tracing::warn!(path = %path.display(), %found, "a kept bundle is damaged; it is fetched again");
            false
        }
        Ok(Err(error)) if error.kind() == std::io::ErrorKind::NotFound => false,
        Ok(Err(error)) => {
            tracing::warn!(path = %path.display(), %error, "a kept bundle cannot be read; it is fetched again");
            false
        }
        // The runtime is shutting down.
        Err(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_kept_file_is_whole_only_if_every_bit_of_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("kept.zip");
        let hash = ArtifactHash(*blake3::hash(b"a bundle").as_bytes());
        assert!(!is_whole(&path, hash).await);
        fs::write(&path, b"a bundle").unwrap();
        assert!(is_whole(&path, hash).await);
        fs::write(&path, b"a bundlE").unwrap();
        assert!(!is_whole(&path, hash).await);
    }
}
