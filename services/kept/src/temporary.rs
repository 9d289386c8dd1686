//! Folders that are not kept: for the time of a task or of a program.
//!
//! A process that is killed cannot remove its own. So each folder is locked for as long as its process lives, and
//! [`remove_abandoned`] removes those without a lock.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;
use std::time::{Duration, SystemTime};
use tempfile::TempDir;

/// Start of the names of temporary folders.
const PREFIX: &str = "forelight-temporary-";

/// A folder of this age is locked, if its process lives.
const LOCKED_BY: Duration = Duration::from_secs(60);

/// A folder for this user alone. It is removed with everything in it when this value is dropped.
#[derive(Debug)]
pub struct TemporaryFolder {
    folder: TempDir,
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
    /// If it cannot be created or opened. The error names the place.
    pub fn new_in(place: &Path) -> io::Result<Self> {
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(place)?;
        let lock = File::open(folder.path())?;
        // A file system may know no locks. There the folder stays if the process is killed.
        let _ = lock.try_lock();
        Ok(Self { folder, _lock: lock })
    }

    /// The folder's path.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Removes the temporary folders in `place` whose processes were killed. Returns their number.
pub fn remove_abandoned(place: &Path) -> usize {
    let entries = fs::read_dir(place).into_iter().flatten().flatten();
    let named = entries.filter(|entry| entry.file_name().as_encoded_bytes().starts_with(PREFIX.as_bytes()));
    named.filter(|entry| is_abandoned(entry) && fs::remove_dir_all(entry.path()).is_ok()).count()
}

fn is_abandoned(entry: &fs::DirEntry) -> bool {
    let Ok(about) = entry.metadata() else { return false };
    let age = about.modified().ok().and_then(|changed| SystemTime::now().duration_since(changed).ok());
    let is_own = about.is_dir() && about.uid() == rustix::process::geteuid().as_raw();
    let flags = (rustix::fs::OFlags::DIRECTORY | rustix::fs::OFlags::NOFOLLOW).bits().cast_signed();
    let is_free = || {
        let folder = OpenOptions::new().read(true).custom_flags(flags).open(entry.path());
        folder.is_ok_and(|folder| folder.try_lock().is_ok())
    };
    is_own && age.is_some_and(|age| age > LOCKED_BY) && is_free()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(place: &Path) -> Vec<String> {
        let entries = fs::read_dir(place).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn age(folder: &Path) {
        let before = SystemTime::now() - 2 * LOCKED_BY;
        File::open(folder).unwrap().set_modified(before).unwrap();
    }

    #[test]
    fn a_folder_is_removed_with_its_files_when_it_is_dropped() {
        let place = tempfile::tempdir().unwrap();
        let folder = TemporaryFolder::new_in(place.path()).unwrap();
        fs::write(folder.path().join("image.exr"), "pixels").unwrap();
        assert_eq!(names(place.path()).len(), 1);
        drop(folder);
        assert!(names(place.path()).is_empty());
    }

    #[test]
    fn what_a_killed_process_left_is_removed_and_nothing_else() {
        let place = tempfile::tempdir().unwrap();
        let made = |name: &str| {
            let folder = place.path().join(format!("{PREFIX}{name}"));
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join("image.exr"), "pixels").unwrap();
            folder
        };
        let in_use = TemporaryFolder::new_in(place.path()).unwrap();
        let (left, _young, other) = (made("left"), made("young"), place.path().join("forelight-data"));
        fs::create_dir(&other).unwrap();
        [in_use.path(), &left, &other].into_iter().for_each(age);
        let link = place.path().join(format!("{PREFIX}link"));
        std::os::unix::fs::symlink(&other, &link).unwrap();
        assert_eq!(remove_abandoned(place.path()), 1);
        let in_use_name = in_use.path().file_name().unwrap().to_str().unwrap().to_owned();
        let mut expected =
            vec!["forelight-data".to_owned(), format!("{PREFIX}link"), format!("{PREFIX}young"), in_use_name];
        expected.sort();
        assert_eq!(names(place.path()), expected);
        assert_eq!(remove_abandoned(&place.path().join("missing")), 0);
    }
}
