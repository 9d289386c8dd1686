//! Bundles at hand: fetched from the service once, kept on disk by their hash, and kept open in memory.
//!
//! One library serves all workers of a process, so that a bundle is fetched and loaded once however many there are.

use crate::renderer::{OpenRenderer, RenderError, Renderer};
use forelight_client::{Client, ClientError};
use forelight_protocol::{ArtifactHash, BundleSource};
use parking_lot::Mutex;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// Opened bundles that are kept: a worker goes from job to job, rarely between more than two at once.
const OPEN_BUNDLES: usize = 3;
/// Fetched bundles are thrown away, the longest unused first, when they take more bytes than this.
const DISK_BYTES: u64 = 16 << 30;

/// Bundles at hand.
pub struct Library {
    folder: PathBuf,
    opener: Box<dyn OpenRenderer>,
    /// The most recently used last.
    open: Mutex<Vec<(Stamp, Slot)>>,
    fetching: tokio::sync::Mutex<()>,
}

/// A place for an opened bundle, locked while it is being opened.
type Slot = Arc<Mutex<Option<Arc<dyn Renderer>>>>;

/// Which content of which path: a bundle on shared storage may be another one tomorrow.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Stamp {
    path: PathBuf,
    files: Vec<(PathBuf, u64, Option<SystemTime>)>,
}

impl std::fmt::Debug for Library {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Library").field("folder", &self.folder).finish_non_exhaustive()
    }
}

impl Library {
    /// A library that keeps fetched bundles in `folder`, which is made if it is not there.
    pub fn new(folder: &Path, opener: Box<dyn OpenRenderer>) -> Result<Self, std::io::Error> {
        fs::create_dir_all(folder)?;
        let folder = folder.to_owned();
        Ok(Self { folder, opener, open: Mutex::default(), fetching: tokio::sync::Mutex::default() })
    }

    /// Where the bundle of a task lies on this machine; fetches it if need be.
    pub async fn locate(&self, client: &Client, source: &BundleSource) -> Result<PathBuf, ClientError> {
        let hash = match source {
            BundleSource::Path(path) => return Ok(path.into()),
            BundleSource::Artifact(hash) => *hash,
        };
        let _one_at_a_time = self.fetching.lock().await;
        let path = self.folder.join(format!("{hash}.zip"));
        let failed = |source| ClientError::File { path: path.clone(), source };
        if path.exists() {
            // The time of last use decides what is thrown away.
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

    /// The opened bundle at `path`, loaded now or before.
    pub fn open(&self, path: &Path) -> Result<Arc<dyn Renderer>, RenderError> {
        // What was fetched is named by its hash and never changes.
        let stamp = if path.starts_with(&self.folder) {
            Stamp { path: path.to_owned(), files: Vec::new() }
        } else {
            Stamp::of(path)
        };
        let slot = self.slot(stamp);
        let mut place = slot.lock();
        if let Some(renderer) = &*place {
            return Ok(renderer.clone());
        }
        let renderer = self.opener.open(path)?;
        *place = Some(renderer.clone());
        Ok(renderer)
    }

    fn slot(&self, stamp: Stamp) -> Slot {
        let mut open = self.open.lock();
        let entry = match open.iter().position(|(known, _)| *known == stamp) {
            Some(index) => open.remove(index),
            None => (stamp, Slot::default()),
        };
        let slot = entry.1.clone();
        open.push(entry);
        let surplus = open.len().saturating_sub(OPEN_BUNDLES);
        open.drain(..surplus);
        slot
    }

    /// Throws away fetched bundles, the longest unused first, until the rest takes at most `limit` bytes; `keep` stays.
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
            // A bundle that is being read stays readable until it is closed; one that cannot be removed only takes room.
            if fs::remove_file(&path).is_ok() {
                bytes -= size;
            }
        }
    }
}

impl Stamp {
    fn of(path: &Path) -> Self {
        let mut files = Vec::new();
        list(path, &mut files);
        files.sort();
        Self { path: path.to_owned(), files }
    }
}

/// Names, sizes and times of the files at and below a path. What cannot be read is left to the loader to complain about.
fn list(path: &Path, files: &mut Vec<(PathBuf, u64, Option<SystemTime>)>) {
    let Ok(about) = fs::symlink_metadata(path) else { return };
    if about.is_dir() {
        for entry in fs::read_dir(path).into_iter().flatten().flatten() {
            list(&entry.path(), files);
        }
    } else {
        files.push((path.to_owned(), about.len(), about.modified().ok()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};
    use std::time::Duration;

    /// Counts how often it was asked, and opens nothing.
    struct Counting(Arc<AtomicU32>);

    impl OpenRenderer for Counting {
        fn open(&self, path: &Path) -> Result<Arc<dyn Renderer>, RenderError> {
            self.0.fetch_add(1, Ordering::SeqCst);
            crate::Ambient::new(forelight_preview::Choice::Cpu).open(path).map(|shot| Arc::new(shot) as _)
        }
    }

    /// A triangle without a camera move.
    const SCENE: &str = r#"{"version":1,"name":"t","geometry":["t.obj"],
        "camera":{"origin":[0,0,4],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":4,"height":4}}"#;

    fn bundle(folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        fs::write(folder.join("scene.json"), SCENE).unwrap();
        fs::write(folder.join("t.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    }

    #[test]
    fn a_bundle_is_opened_once_by_all_who_want_it_and_again_when_others_pushed_it_out() {
        let folder = tempfile::tempdir().unwrap();
        let opened = Arc::new(AtomicU32::new(0));
        let library = Library::new(&folder.path().join("kept"), Box::new(Counting(opened.clone()))).unwrap();
        let paths: Vec<PathBuf> = (0..=OPEN_BUNDLES).map(|i| folder.path().join(i.to_string())).collect();
        paths.iter().for_each(|path| bundle(path));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| library.open(&paths[0]).map(drop).unwrap());
            }
        });
        assert_eq!(opened.load(Ordering::SeqCst), 1);
        for path in &paths[1..] {
            library.open(path).map(drop).unwrap();
        }
        library.open(&paths[0]).map(drop).unwrap();
        assert_eq!(opened.load(Ordering::SeqCst), OPEN_BUNDLES as u32 + 2);
    }

    #[test]
    fn touching_a_fetched_bundle_does_not_make_it_another() {
        let folder = tempfile::tempdir().unwrap();
        let opened = Arc::new(AtomicU32::new(0));
        let library = Library::new(folder.path(), Box::new(Counting(opened.clone()))).unwrap();
        // Stands for a zip: what is inside the library's folder is what was fetched.
        let fetched = folder.path().join("hash.zip");
        bundle(&fetched);
        library.open(&fetched).map(drop).unwrap();
        let file = fs::File::options().append(true).open(fetched.join("t.obj")).unwrap();
        file.set_modified(SystemTime::now() + Duration::from_secs(5)).unwrap();
        library.open(&fetched).map(drop).unwrap();
        assert_eq!(opened.load(Ordering::SeqCst), 1);
    }

    #[test]
    fn room_is_made_by_throwing_away_what_was_unused_for_longest() {
        let folder = tempfile::tempdir().unwrap();
        let library = Library::new(folder.path(), Box::new(Counting(Arc::default()))).unwrap();
        let hashes: Vec<ArtifactHash> = (0..4).map(|i| ArtifactHash([i; 32])).collect();
        let path = |hash: &ArtifactHash| folder.path().join(format!("{hash}.zip"));
        for (age, hash) in (0..).zip(&hashes) {
            fs::write(path(hash), [0; 10]).unwrap();
            let file = fs::File::options().append(true).open(path(hash)).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(100 - age)).unwrap();
        }
        // The oldest is the one that was just fetched.
        library.make_room(hashes[0], 25);
        let left: Vec<bool> = hashes.iter().map(|hash| path(hash).exists()).collect();
        assert_eq!(left, [true, false, false, true]);
    }
}
