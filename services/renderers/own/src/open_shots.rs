//! Shots that are open. All workers of a process share them, so that a bundle is loaded once.

use crate::{OwnRenderer, OwnShot, RenderError};
use forelight_protocol::{ArtifactHash, BundleSource};
use parking_lot::Mutex;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// Opened bundles to keep. A worker rarely alternates between more than two jobs.
const OPEN_BUNDLES: usize = 3;

/// Opens bundles, and keeps the last few open.
pub struct OpenShots {
    renderer: OwnRenderer,
    /// The most recently used last.
    open: Mutex<Vec<(Stamp, Slot)>>,
}

/// A place for an opened bundle, locked while it is being opened.
type Slot = Arc<Mutex<Option<Arc<OwnShot>>>>;

/// Identifies the content of a bundle. Files on shared storage may change from one day to the next.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Stamp {
    /// A fetched bundle: its hash.
    Fetched(ArtifactHash),
    /// A bundle on shared storage: its path, and names, sizes and times of its files.
    Shared(PathBuf, Vec<(PathBuf, u64, Option<SystemTime>)>),
}

impl std::fmt::Debug for OpenShots {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OpenShots").finish_non_exhaustive()
    }
}

impl OpenShots {
    /// No shots yet. `renderer` opens them.
    pub fn new(renderer: OwnRenderer) -> Self {
        Self { renderer, open: Mutex::default() }
    }

    /// Returns the opened bundle at `path`, where `source` was fetched to or lies. Loads it unless it is open.
    ///
    /// # Errors
    /// If the bundle cannot be opened.
    pub fn open(&self, source: &BundleSource, path: &Path) -> Result<Arc<OwnShot>, RenderError> {
        let stamp = match source {
            BundleSource::Artifact(hash) => Stamp::Fetched(*hash),
            BundleSource::Path(_) => Stamp::of(path),
        };
        let slot = self.slot(stamp);
        let mut place = slot.lock();
        if let Some(shot) = &*place {
            return Ok(shot.clone());
        }
        let shot = Arc::new(self.renderer.open(path)?);
        *place = Some(shot.clone());
        Ok(shot)
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
    use forelight_preview::Choice;
    use std::time::Duration;

    /// A triangle without a camera move.
    const SCENE: &str = r#"{"version":1,"name":"t","geometry":["t.obj"],
        "camera":{"origin":[0,0,4],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":4,"height":4}}"#;

    fn bundle(folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        fs::write(folder.join("scene.json"), SCENE).unwrap();
        fs::write(folder.join("t.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    }

    fn shots() -> OpenShots {
        OpenShots::new(OwnRenderer::new(Choice::Cpu))
    }

    #[test]
    fn a_bundle_is_opened_once_by_all_threads_and_again_after_others_replaced_it() {
        let folder = tempfile::tempdir().unwrap();
        let shots = shots();
        let paths: Vec<PathBuf> = (0..=OPEN_BUNDLES).map(|i| folder.path().join(i.to_string())).collect();
        paths.iter().for_each(|path| bundle(path));
        let open = |path: &Path| {
            let source = BundleSource::Path(path.display().to_string());
            shots.open(&source, path).unwrap()
        };
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
        bundle(folder.path());
        let shots = shots();
        let shared = BundleSource::Path(folder.path().display().to_string());
        let fetched = BundleSource::Artifact(ArtifactHash([7; 32]));
        let open = |source| shots.open(source, folder.path()).unwrap();
        let before = [open(&shared), open(&fetched)];
        let file = fs::File::options().append(true).open(folder.path().join("t.obj")).unwrap();
        file.set_modified(SystemTime::now() + Duration::from_secs(5)).unwrap();
        assert!(!Arc::ptr_eq(&before[0], &open(&shared)));
        assert!(Arc::ptr_eq(&before[1], &open(&fetched)));
    }
}
