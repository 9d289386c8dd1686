//! Shots that are open. All workers of a process share them, so that a bundle is loaded once.

use forelight_protocol::{ArtifactHash, BundleSource};
use parking_lot::Mutex;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// Opened bundles to keep. A worker rarely alternates between more than two jobs.
const OPEN_BUNDLES: usize = 3;

/// Keeps the last few opened bundles.
#[derive(Debug)]
pub struct OpenShots<T: ?Sized> {
    /// The most recently used last.
    open: Mutex<Vec<(Stamp, Slot<T>)>>,
}

/// A place for an opened bundle, locked while it is being opened.
type Slot<T> = Arc<Mutex<Option<Arc<T>>>>;

/// Identifies the content of a bundle. Files on shared storage may change from one day to the next.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Stamp {
    /// A fetched bundle: its hash.
    Fetched(ArtifactHash),
    /// A bundle on shared storage: its path, and names, sizes and times of its files.
    Shared(PathBuf, Vec<(PathBuf, u64, Option<SystemTime>)>),
}

impl<T: ?Sized> Default for OpenShots<T> {
    fn default() -> Self {
        Self { open: Mutex::default() }
    }
}

impl<T: ?Sized> OpenShots<T> {
    /// Returns the opened bundle at `path`, where `source` was fetched to or lies. Unless it is open, `load`
    /// opens it.
    ///
    /// # Errors
    /// The error of `load`.
    pub fn open<E>(
        &self,
        source: &BundleSource,
        path: &Path,
        load: impl FnOnce() -> Result<Arc<T>, E>,
    ) -> Result<Arc<T>, E> {
        let stamp = match source {
            BundleSource::Artifact(hash) => Stamp::Fetched(*hash),
            BundleSource::Path(_) => Stamp::of(path),
        };
        let slot = self.slot(stamp);
        let mut place = slot.lock();
        if let Some(shot) = &*place {
            return Ok(shot.clone());
        }
        let shot = load()?;
        *place = Some(shot.clone());
        Ok(shot)
    }

    fn slot(&self, stamp: Stamp) -> Slot<T> {
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
}

impl Stamp {
    fn of(path: &Path) -> Self {
        let mut files = Vec::new();
        list(path, &mut files);
        files.sort();
        Self::Shared(path.to_owned(), files)
    }
}

/// Names, sizes and times of the files at and below a path. The loader reports what cannot be read.
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
    use std::convert::Infallible;
    use std::time::Duration;

    /// Opens the file, whose text becomes the shot.
    fn open(shots: &OpenShots<String>, source: &BundleSource, path: &Path) -> Arc<String> {
        let load = || Ok::<_, Infallible>(Arc::new(fs::read_to_string(path).unwrap()));
        shots.open(source, path, load).unwrap()
    }

    #[test]
    fn a_bundle_is_opened_once_by_all_threads_and_again_after_others_replaced_it() {
        let folder = tempfile::tempdir().unwrap();
        let shots = OpenShots::default();
        let paths: Vec<PathBuf> = (0..=OPEN_BUNDLES).map(|i| folder.path().join(i.to_string())).collect();
        paths.iter().for_each(|path| fs::write(path, "scene").unwrap());
        let open = |path: &Path| open(&shots, &BundleSource::Path(path.display().to_string()), path);
        let first = open(&paths[0]);
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| assert!(Arc::ptr_eq(&first, &open(&paths[0]))));
            }
        });
        paths[1..].iter().for_each(|path| drop(open(path)));
        assert!(!Arc::ptr_eq(&first, &open(&paths[0])), "three others were opened since");
    }

    #[test]
    fn a_shared_bundle_is_opened_again_after_a_change_and_a_fetched_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene");
        fs::write(&path, "scene").unwrap();
        let shots = OpenShots::default();
        let shared = BundleSource::Path(path.display().to_string());
        let fetched = BundleSource::Artifact(ArtifactHash([7; 32]));
        let before = [open(&shots, &shared, &path), open(&shots, &fetched, &path)];
        let file = fs::File::options().append(true).open(&path).unwrap();
        file.set_modified(SystemTime::now() + Duration::from_secs(5)).unwrap();
        assert!(!Arc::ptr_eq(&before[0], &open(&shots, &shared, &path)));
        assert!(Arc::ptr_eq(&before[1], &open(&shots, &fetched, &path)));
    }
}
