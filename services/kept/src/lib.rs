//! Files that a machine keeps so that work is not done again: fetched bundles, loaded scenes, trees. And
//! [temporary folders](TemporaryFolder), which it does not keep.
//!
//! Hazards: a file may be damaged, be of another version of this program, or have been put there by another
//! user. So a file is used only if its user owns it, nobody else can write it, and it ends with a hash of its
//! content under its name. Its name holds a hash of what it was made from. Otherwise it is made anew. A full
//! disk may stop a farm, so nothing is kept where little space is left.

mod temporary;

pub use temporary::{TemporaryFolder, remove_abandoned};

use std::fs::{self, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// Length of the hash at the end of a file.
const HASH: usize = blake3::OUT_LEN;

/// Files of [`Folder::write`] are deleted, least recently used first, when they exceed this many bytes.
const DISK_BYTES: u64 = 4 << 30;

/// Larger files are not kept.
pub const LARGEST: u64 = 1 << 30;

/// This many bytes of the disk stay free.
const LEAST_FREE: u64 = 2 << 30;

/// Start of the name of a file that is being written. [`Folder::make_room`] deletes those that were left
/// behind.
pub const UNFINISHED: &str = ".keeping-";

/// An unfinished file of this age was left behind by a process that ended.
const LEFT_BEHIND: Duration = Duration::from_secs(3600);

/// Ending of the files of [`Folder::write`].
const ENDING: &str = "kept";

/// Starts the name of a file: a hasher that has seen the sources of this program, on which every content
/// depends, the byte order, and `what` is kept.
pub fn named(what: &str) -> blake3::Hasher {
    let mut hasher = blake3::Hasher::new();
    hasher.update(env!("KEPT_SOURCES").as_bytes());
    hasher.update(&1u16.to_ne_bytes());
    hasher.update(what.as_bytes());
    hasher
}

/// A folder of kept files.
#[derive(Debug, Clone)]
pub struct Folder(PathBuf);

impl Folder {
    /// Keeps files in `path`. If it does not exist, it is created, for this user alone.
    ///
    /// # Errors
    /// If the folder cannot be created, belongs to another user, or others can write in it.
    pub fn new(path: &Path) -> io::Result<Self> {
        fs::DirBuilder::new().recursive(true).mode(0o700).create(path)?;
        own(&fs::metadata(path)?)?;
        Ok(Self(path.to_owned()))
    }

    /// The folder's path.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The content that was written under a name. `None` if there is none, or it cannot be used.
    pub fn read(&self, name: &blake3::Hash) -> Option<Vec<u8>> {
        let path = self.path_of(name);
        match read(&path, name) {
            Ok(content) => {
                used(&path);
                Some(content)
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => {
                tracing::warn!(path = %path.display(), %error, "a kept file cannot be used; it is made anew");
                None
            }
        }
    }

    /// Keeps the concatenation of `parts` under a name, for this user alone. If that fails, or little space
    /// is left on the disk, nothing is kept.
    pub fn write(&self, name: &blake3::Hash, parts: &[&[u8]]) {
        let bytes: u64 = parts.iter().map(|part| part.len() as u64).sum();
        if bytes > LARGEST || self.free_bytes() < bytes + LEAST_FREE {
            return;
        }
        let path = self.path_of(name);
        let write = || {
            let mut file = tempfile::Builder::new().prefix(UNFINISHED).tempfile_in(&self.0)?;
            let mut hasher = blake3::Hasher::new_keyed(name.as_bytes());
            for part in parts {
                file.write_all(part)?;
                hasher.update(part);
            }
            file.write_all(hasher.finalize().as_bytes())?;
            file.persist(&path).map_err(|error| error.error)
        };
        match write() {
            Ok(_) => self.make_room(ENDING, &path, DISK_BYTES),
            Err(error) => tracing::warn!(path = %path.display(), %error, "a file cannot be kept"),
        }
    }

    /// Free bytes of the folder's disk. 0 if they are not known.
    fn free_bytes(&self) -> u64 {
        rustix::fs::statvfs(&self.0).map_or(0, |disk| disk.f_bavail.saturating_mul(disk.f_frsize))
    }

    fn path_of(&self, name: &blake3::Hash) -> PathBuf {
        self.0.join(format!("{name}.{ENDING}"))
    }

    /// Deletes files with this ending, least recently used first, until the rest fits in `limit` bytes.
    /// Leaves the file `keep`. Also deletes files that ended processes left unfinished.
    pub fn make_room(&self, ending: &str, keep: &Path, limit: u64) {
        let Ok(entries) = fs::read_dir(&self.0) else { return };
        let (mut files, now) = (Vec::new(), SystemTime::now());
        for path in entries.flatten().map(|entry| entry.path()) {
            let Some((used, about)) =
                fs::symlink_metadata(&path).ok().and_then(|about| Some((about.modified().ok()?, about)))
            else {
                continue;
            };
            let is_unfinished = path
                .file_name()
                .is_some_and(|name| name.as_encoded_bytes().starts_with(UNFINISHED.as_bytes()));
            if path.extension().is_some_and(|found| found == ending) {
                files.push((used, about.len(), path));
            } else if is_unfinished && now.duration_since(used).is_ok_and(|age| age > LEFT_BEHIND) {
                let _ = fs::remove_file(&path);
            }
        }
        files.sort();
        let mut bytes: u64 = files.iter().map(|(_, size, _)| size).sum();
        for (_, size, path) in files {
            if bytes <= limit {
                return;
            }
            // A file in use stays readable until it is closed. One that cannot be removed only takes space.
            // Another process may have removed it.
            let is_gone = |error: io::Error| error.kind() == io::ErrorKind::NotFound;
            if path != keep && fs::remove_file(&path).map_or_else(is_gone, |()| true) {
                bytes -= size;
            }
        }
    }
}

/// Notes that a file is used now. The time of last use decides which files are deleted.
pub fn used(path: &Path) {
    if let Ok(file) = OpenOptions::new().append(true).custom_flags(plain_file()).open(path) {
        let _ = file.set_modified(SystemTime::now());
    }
}

/// Flags that keep an open from following a link or waiting for a pipe.
fn plain_file() -> i32 {
    (rustix::fs::OFlags::NONBLOCK | rustix::fs::OFlags::NOFOLLOW).bits().cast_signed()
}

/// Whether this user alone can write it; the error says why not.
fn own(about: &fs::Metadata) -> io::Result<()> {
    let refused = |reason: &str| Err(io::Error::new(io::ErrorKind::PermissionDenied, reason));
    if about.uid() != rustix::process::geteuid().as_raw() {
        return refused("it belongs to another user");
    }
    if about.mode() & 0o022 != 0 {
        return refused("other users can write it");
    }
    Ok(())
}

/// The content of a file, without the hash at its end.
fn read(path: &Path, name: &blake3::Hash) -> io::Result<Vec<u8>> {
    let mut file = OpenOptions::new().read(true).custom_flags(plain_file()).open(path)?;
    let about = file.metadata()?;
    let refused = |reason: &str| io::Error::new(io::ErrorKind::InvalidData, reason);
    if !about.is_file() {
        return Err(refused("it is not a file"));
    }
    own(&about)?;
    if about.len() > LARGEST + HASH as u64 {
        return Err(refused("it is too large"));
    }
    let mut content = Vec::with_capacity(about.len() as usize);
    file.read_to_end(&mut content)?;
    let end = content.len().checked_sub(HASH).ok_or_else(|| refused("it is cut short"))?;
    let hash: [u8; HASH] = content[end..].try_into().map_err(|_| refused("it is cut short"))?;
    content.truncate(end);
    if blake3::keyed_hash(name.as_bytes(), &content) != hash {
        return Err(refused("it is damaged"));
    }
    Ok(content)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::os::unix::fs::PermissionsExt as _;

    fn folder() -> (Folder, tempfile::TempDir) {
        let beside = tempfile::tempdir().unwrap();
        (Folder::new(&beside.path().join("a/b")).unwrap(), beside)
    }

    #[test]
    fn folder_and_files_are_their_users_alone() {
        let (folder, _beside) = folder();
        let name = named("x").finalize();
        folder.write(&name, &[b"con", b"tent"]);
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(folder.path()), 0o700);
        assert_eq!(mode(folder.path().parent().unwrap()), 0o700);
        assert_eq!(mode(&folder.path_of(&name)), 0o600);
    }

    #[test]
    fn a_file_is_used_only_if_every_bit_of_it_is_as_written() {
        let (folder, _beside) = folder();
        let name = named("x").finalize();
        assert_eq!(folder.read(&name), None);
        folder.write(&name, &[b"con", b"tent"]);
        assert_eq!(folder.read(&name).as_deref(), Some(&b"content"[..]));
        assert_eq!(folder.read(&named("y").finalize()), None);
        let whole = fs::read(folder.path_of(&name)).unwrap();
        for byte in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[byte] ^= 4;
            fs::write(folder.path_of(&name), &damaged).unwrap();
            assert_eq!(folder.read(&name), None, "byte {byte} is damaged");
            fs::write(folder.path_of(&name), &whole[..byte]).unwrap();
            assert_eq!(folder.read(&name), None, "cut at byte {byte}");
        }
        folder.write(&name, &[b"con", b"tent"]);
        assert_eq!(folder.read(&name).as_deref(), Some(&b"content"[..]));
    }

    #[test]
    fn a_file_that_others_could_have_written_is_not_used() {
        let (folder, beside) = folder();
        let name = named("x").finalize();
        folder.write(&name, &[b"con", b"tent"]);
        let path = folder.path_of(&name);
        fs::set_permissions(&path, fs::Permissions::from_mode(0o620)).unwrap();
        assert_eq!(folder.read(&name), None);
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        let elsewhere = beside.path().join("elsewhere");
        fs::rename(&path, &elsewhere).unwrap();
        std::os::unix::fs::symlink(&elsewhere, &path).unwrap();
        assert_eq!(folder.read(&name), None);
    }

    #[test]
    fn a_file_under_another_name_is_not_used() {
        let (folder, _beside) = folder();
        let (name, other) = (named("x").finalize(), named("y").finalize());
        folder.write(&name, &[b"content"]);
        fs::rename(folder.path_of(&name), folder.path_of(&other)).unwrap();
        assert_eq!(folder.read(&other), None);
    }

    #[test]
    fn a_folder_that_others_can_write_in_is_refused() {
        let (folder, _beside) = folder();
        fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o770)).unwrap();
        let error = Folder::new(folder.path()).unwrap_err();
        assert_eq!(error.to_string(), "other users can write it");
    }

    #[test]
    fn what_an_ended_process_left_unfinished_is_removed_and_what_another_writes_is_not() {
        let (folder, _beside) = folder();
        let [old, new] = [".keeping-old", ".keeping-new"].map(|name| folder.path().join(name));
        fs::write(&old, "x").unwrap();
        fs::write(&new, "x").unwrap();
        let hours_ago = SystemTime::now() - 2 * LEFT_BEHIND;
        File::options().append(true).open(&old).unwrap().set_modified(hours_ago).unwrap();
        folder.write(&named("x").finalize(), &[b"content"]);
        assert!(!old.exists() && new.exists());
    }

    #[test]
    fn room_is_made_by_throwing_away_what_was_unused_for_longest() {
        let (folder, _beside) = folder();
        let names: Vec<blake3::Hash> = (0..4).map(|i| named(&format!("{i}")).finalize()).collect();
        for (age, name) in (0..).zip(&names) {
            folder.write(name, &[&[0; 10 - HASH % 10]]);
            let file = File::options().append(true).open(folder.path_of(name)).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(100 - age)).unwrap();
        }
        fs::write(folder.path().join("other.zip"), [0; 1000]).unwrap();
        let size = fs::metadata(folder.path_of(&names[0])).unwrap().len();
        // The oldest was just written, and the next was just read.
        folder.read(&names[1]).unwrap();
        folder.make_room(ENDING, &folder.path_of(&names[0]), size * 5 / 2);
        let left: Vec<bool> = names.iter().map(|name| folder.path_of(name).exists()).collect();
        assert_eq!(left, [true, true, false, false]);
        assert!(folder.path().join("other.zip").exists());
    }
}
