//! Folders that are not kept: for the time of a task or of a program.
//!
//! A process that is killed cannot remove its own. So beside the files of each folder there is a file that is
//! locked while its process lives, and [`remove_abandoned`] removes the folders whose file nobody locks. A
//! file is locked, because on a network's file systems other machines see that. They do not see locks of
//! folders.

use std::fs::{self, File, OpenOptions, Permissions};
use std::io;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Start of the names of temporary folders.
const PREFIX: &str = "forelight-temporary-";

/// The locked file. It has this name once it is locked.
const LOCK: &str = "lock";

/// The folder of the files.
const FILES: &str = "files";

/// A folder for this user alone. It is removed with everything in it when this value is dropped.
#[derive(Debug)]
pub struct TemporaryFolder {
    /// Where the files are.
    files: PathBuf,
    /// Removed when it is dropped.
    _folder: TempDir,
    /// Locked. Dropped after the folder, which no other process may remove meanwhile.
    _lock: File,
}

impl TemporaryFolder {
    /// Makes a folder where the system has temporary files.
    ///
    /// # Errors
    /// Those of [`Self::new_in`].
    pub fn new() -> io::Result<Self> {
        Self::new_in(&std::env::temp_dir())
    }

    /// Makes a folder in `place`.
    ///
    /// # Errors
    /// If the folder or a file in it cannot be made.
    pub fn new_in(place: &Path) -> io::Result<Self> {
        let mut named = tempfile::Builder::new();
        let folder = named.prefix(PREFIX).permissions(Permissions::from_mode(0o700)).tempdir_in(place)?;
        let unlocked = folder.path().join("unlocked");
        let lock = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&unlocked)?;
        // Where there are no locks, nobody else can lock it either, and the folder stays if the process is
        // killed.
        let _ = lock.try_lock();
        fs::rename(&unlocked, folder.path().join(LOCK))?;
        let files = folder.path().join(FILES);
        fs::create_dir(&files)?;
        Ok(Self { files, _folder: folder, _lock: lock })
    }

    /// Where its files are.
    pub fn path(&self) -> &Path {
        &self.files
    }
}

/// Removes the temporary folders of this user in `place` whose processes were killed. Returns their number.
pub fn remove_abandoned(place: &Path) -> usize {
    let entries = fs::read_dir(place).into_iter().flatten().flatten();
    let named = entries.filter(|entry| entry.file_name().as_encoded_bytes().starts_with(PREFIX.as_bytes()));
    named.filter(is_removed).count()
}

/// Whether a folder was abandoned, and could be removed.
fn is_removed(entry: &fs::DirEntry) -> bool {
    let is_own = |about: fs::Metadata| about.is_dir() && about.uid() == rustix::process::geteuid().as_raw();
    if !entry.metadata().is_ok_and(is_own) {
        return false;
    }
    let lock = entry.path().join(LOCK);
    let lock = OpenOptions::new().write(true).custom_flags(super::plain_file()).open(lock);
    // It stays locked until the folder is gone.
    lock.is_ok_and(|lock| lock.try_lock().is_ok() && fs::remove_dir_all(entry.path()).is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn names(place: &Path) -> BTreeSet<String> {
        let entries = fs::read_dir(place).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    /// What a process leaves that is killed: all but the lock.
    fn left_by_a_killed_process(place: &Path) -> PathBuf {
        let TemporaryFolder { _folder, .. } = TemporaryFolder::new_in(place).unwrap();
        _folder.keep()
    }

    #[test]
    fn a_folder_is_its_users_alone_and_is_removed_with_its_files_when_it_is_dropped() {
        let place = tempfile::tempdir().unwrap();
        let folder = TemporaryFolder::new_in(place.path()).unwrap();
        fs::write(folder.path().join("image.exr"), "pixels").unwrap();
        let mode = fs::metadata(folder.path().parent().unwrap()).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        assert_eq!(names(place.path()).len(), 1);
        drop(folder);
        assert!(names(place.path()).is_empty());
    }

    #[test]
    fn what_a_killed_process_left_is_removed_and_nothing_else() {
        let place = tempfile::tempdir().unwrap();
        let in_use = TemporaryFolder::new_in(place.path()).unwrap();
        let left = left_by_a_killed_process(place.path());
        // Another's data, a link to a folder that was left elsewhere, and a folder that is still being made.
        fs::create_dir(place.path().join("forelight-data")).unwrap();
        let elsewhere = tempfile::tempdir().unwrap();
        let aim = left_by_a_killed_process(elsewhere.path());
        std::os::unix::fs::symlink(&aim, place.path().join(format!("{PREFIX}link"))).unwrap();
        fs::create_dir(place.path().join(format!("{PREFIX}new"))).unwrap();
        let mut expected = names(place.path());
        expected.remove(left.file_name().unwrap().to_str().unwrap());
        assert_eq!((remove_abandoned(place.path()), names(place.path())), (1, expected));
        assert!(in_use.path().is_dir() && aim.is_dir());
        assert_eq!(remove_abandoned(elsewhere.path()), 1);
        assert_eq!(remove_abandoned(&place.path().join("missing")), 0);
    }
}
