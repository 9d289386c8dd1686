//! Bundles fetched from the service: kept on disk by their hash.
//!
//! All workers of a process share one folder, so that a bundle is fetched once. Each task verifies the file's
//! hash before it is opened: a damaged one is fetched again. The folder is its user's alone.

use forelight_client::{Client, ClientError};
use forelight_protocol::{ArtifactHash, BundleSource};
use std::fs;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Fetched bundles are deleted, least recently used first, when they exceed this many bytes.
const DISK_BYTES: u64 = 16 << 30;

/// A folder of fetched bundles.
#[derive(Debug)]
pub struct Bundles {
    folder: PathBuf,
    fetching: tokio::sync::Mutex<()>,
}

impl Bundles {
    /// Keeps bundles in `folder`. If it does not exist, it is created, for this user alone.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn new(folder: &Path) -> Result<Self, std::io::Error> {
        fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        Ok(Self { folder: folder.to_owned(), fetching: tokio::sync::Mutex::default() })
    }

    /// Path of a task's bundle on this machine. Fetches the bundle if needed.
    pub async fn locate(&self, client: &Client, source: &BundleSource) -> Result<PathBuf, ClientError> {
        let hash = match source {
            BundleSource::Path(path) => return Ok(path.into()),
            BundleSource::Artifact(hash) => *hash,
        };
        let _one_at_a_time = self.fetching.lock().await;
        let path = self.folder.join(format!("{hash}.zip"));
        let failed = |source| ClientError::File { path: path.clone(), source };
        if is_whole(&path, hash).await {
            // The time of last use decides which bundles are deleted.
            if let Ok(file) = fs::File::options().append(true).open(&path) {
                let _ = file.set_modified(SystemTime::now());
            }
            return Ok(path);
        }
        let partial = tempfile::Builder::new()
            .prefix(".fetching-")
            .tempfile_in(&self.folder)
            .map_err(failed)?
            .into_temp_path();
        client.artifact_to_file(hash, &partial).await?;
        partial.persist(&path).map_err(|error| failed(error.error))?;
        self.make_room(hash, DISK_BYTES);
        Ok(path)
    }

    /// Deletes fetched bundles, least recently used first, until the rest fits in `limit` bytes. Keeps
    /// `keep`.
    fn make_room(&self, keep: ArtifactHash, limit: u64) {
        let keep = format!("{keep}.zip");
        let Ok(entries) = fs::read_dir(&self.folder) else { return };
        let mut bundles: Vec<(SystemTime, u64, PathBuf)> = entries
            .flatten()
            .filter(|entry| entry.path().extension().is_some_and(|e| e == "zip"))
            .filter_map(|entry| {
                let about = entry.metadata().ok()?;
                Some((about.modified().ok()?, about.len(), entry.path()))
            })
            .collect();
        bundles.sort();
        let mut bytes: u64 = bundles.iter().map(|(_, size, _)| size).sum();
        for (_, size, path) in bundles {
            if bytes <= limit {
                return;
            }
            if path.file_name().is_some_and(|name| *name == *keep) {
                continue;
            }
            // A bundle in use stays readable until it is closed. One that cannot be removed only takes space.
            if fs::remove_file(&path).is_ok() {
                bytes -= size;
            }
        }
    }
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
    use std::time::Duration;

    #[test]
    fn the_folder_is_its_users_alone() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let made = folder.path().join("a/b");
        Bundles::new(&made).unwrap();
        for folder in [made.as_path(), made.parent().unwrap()] {
            assert_eq!(fs::metadata(folder).unwrap().permissions().mode() & 0o777, 0o700);
        }
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

    #[test]
    fn room_is_made_by_throwing_away_what_was_unused_for_longest() {
        let folder = tempfile::tempdir().unwrap();
        let bundles = Bundles::new(folder.path()).unwrap();
        let hashes: Vec<ArtifactHash> = (0..4).map(|i| ArtifactHash([i; 32])).collect();
        let path = |hash: &ArtifactHash| folder.path().join(format!("{hash}.zip"));
        for (age, hash) in (0..).zip(&hashes) {
            fs::write(path(hash), [0; 10]).unwrap();
            let file = fs::File::options().append(true).open(path(hash)).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(100 - age)).unwrap();
        }
        // The oldest is the one that was just fetched.
        bundles.make_room(hashes[0], 25);
        let left: Vec<bool> = hashes.iter().map(|hash| path(hash).exists()).collect();
        assert_eq!(left, [true, false, false, true]);
    }
}
