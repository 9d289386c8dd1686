//! Bundles fetched from the service: kept on disk by their hash.
//!
//! All workers of a process share one folder, so that a bundle is fetched once. Each task verifies the file's
//! hash before it is opened: a damaged one is fetched again. The folder is its user's alone.

use forelight_client::{Client, ClientError};
use forelight_kept::Folder;
use forelight_protocol::{ArtifactHash, BundleSource};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use tempfile::TempDir;

/// Fetched bundles are deleted, least recently used first, when they exceed this many bytes.
const DISK_BYTES: u64 = 16 << 30;

/// Beginning of the names of folders of pictures.
const PICTURES: &str = ".pictures-";

/// Pictures that a killed process left are removed after this time.
const LEFT_FOR: Duration = Duration::from_secs(24 * 3600);

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
        remove_left_pictures(folder.path());
        Ok(Self { folder, fetching: tokio::sync::Mutex::default() })
    }

    /// A folder for the pictures of one task, removed when it is dropped.
    pub(crate) fn folder_for_pictures(&self) -> Result<TempDir, std::io::Error> {
        tempfile::Builder::new().prefix(PICTURES).tempdir_in(self.folder.path())
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

/// Removes folders of pictures that ended processes left behind.
fn remove_left_pictures(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let is_of_pictures = entry.file_name().as_encoded_bytes().starts_with(PICTURES.as_bytes());
        let changed = entry.metadata().and_then(|about| about.modified());
        let age = changed.ok().and_then(|changed| SystemTime::now().duration_since(changed).ok());
        if is_of_pictures && age.is_some_and(|age| age > LEFT_FOR) {
            let _ = fs::remove_dir_all(entry.path());
        }
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

    #[test]
    fn pictures_that_a_killed_process_left_are_removed_after_a_day() {
        let folder = tempfile::tempdir().unwrap();
        let [old, new] = ["old", "new"].map(|name| folder.path().join(format!("{PICTURES}{name}")));
        for path in [&old, &new] {
            fs::create_dir(path).unwrap();
            fs::write(path.join("000000.png"), b"a picture").unwrap();
        }
        let before = SystemTime::now() - 2 * LEFT_FOR;
        fs::File::open(&old).unwrap().set_modified(before).unwrap();
        Bundles::new(folder.path()).unwrap();
        assert!(!old.exists() && new.exists());
    }

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
