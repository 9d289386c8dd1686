//! Files that a machine keeps so that work is not done again: fetched bundles, loaded scenes, trees.
//!
//! Hazards: a file may be damaged, be of another version of this program, or have been put there by another
//! user. So a file is used only if its user owns it, nobody else can write it, and it ends with its own hash.
//! Its name holds a hash of what it was made from. Otherwise it is made anew.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Length of the hash at the end of a file.
const HASH: usize = blake3::OUT_LEN;

/// Files of [`Folder::write`] are deleted, least recently used first, when they exceed this many bytes.
const DISK_BYTES: u64 = 4 << 30;

/// Larger files are not kept.
const LARGEST: u64 = 1 << 30;

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
    /// If the folder cannot be created.
    pub fn new(path: &Path) -> io::Result<Self> {
        fs::DirBuilder::new().recursive(true).mode(0o700).create(path)?;
        Ok(Self(path.to_owned()))
    }

    /// The folder's path.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The content that was written under a name. `None` if there is none, or it cannot be used.
    pub fn read(&self, name: &blake3::Hash) -> Option<Vec<u8>> {
        let path = self.path_of(name);
        match read(&path) {
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

    /// Keeps `content` under a name, for this user alone. If that fails, nothing is kept.
    pub fn write(&self, name: &blake3::Hash, content: &[u8]) {
        if content.len() as u64 > LARGEST {
            return;
        }
        let path = self.path_of(name);
        let write = || {
            let mut file = tempfile::Builder::new().prefix(".keeping-").tempfile_in(&self.0)?;
            file.write_all(content)?;
            file.write_all(blake3::hash(content).as_bytes())?;
            file.persist(&path).map_err(|error| error.error)
        };
        match write() {
            Ok(_) => self.make_room(ENDING, &path, DISK_BYTES),
            Err(error) => tracing::warn!(path = %path.display(), %error, "a file cannot be kept"),
        }
    }

    fn path_of(&self, name: &blake3::Hash) -> PathBuf {
        self.0.join(format!("{name}.{ENDING}"))
    }

    /// Deletes files with this ending, least recently used first, until the rest fits in `limit` bytes. Leaves
    /// the file `keep`.
    pub fn make_room(&self, ending: &str, keep: &Path, limit: u64) {
        let Ok(entries) = fs::read_dir(&self.0) else { return };
        let mut files: Vec<(SystemTime, u64, PathBuf)> = entries
            .flatten()
            .filter(|entry| entry.path().extension().is_some_and(|found| found == ending))
            .filter_map(|entry| {
                let about = entry.metadata().ok()?;
                Some((about.modified().ok()?, about.len(), entry.path()))
            })
            .collect();
        files.sort();
        let mut bytes: u64 = files.iter().map(|(_, size, _)| size).sum();
        for (_, size, path) in files {
            if bytes <= limit {
                return;
            }
            // A file in use stays readable until it is closed. One that cannot be removed only takes space.
            if path != keep && fs::remove_file(&path).is_ok() {
                bytes -= size;
            }
        }
    }
}

/// Notes that a file is used now. The time of last use decides which files are deleted.
pub fn used(path: &Path) {
    if let Ok(file) = File::options().append(true).open(path) {
        let _ = file.set_modified(SystemTime::now());
    }
}

/// The content of a file, without the hash at its end.
fn read(path: &Path) -> io::Result<Vec<u8>> {
    let flags = rustix::fs::OFlags::NONBLOCK | rustix::fs::OFlags::NOFOLLOW;
    let mut file = OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path)?;
    let about = file.metadata()?;
    let refused = |reason: &str| io::Error::new(io::ErrorKind::InvalidData, reason);
    if !about.is_file() {
        return Err(refused("it is not a file"));
    }
    if about.uid() != rustix::process::geteuid().as_raw() || about.mode() & 0o022 != 0 {
        return Err(refused("another user can write it"));
    }
    if about.len() > LARGEST + HASH as u64 {
        return Err(refused("it is too large"));
    }
    let mut content = Vec::with_capacity(about.len() as usize);
    file.read_to_end(&mut content)?;
    let end = content.len().checked_sub(HASH).ok_or_else(|| refused("it is cut short"))?;
    let hash: [u8; HASH] = content[end..].try_into().map_err(|_| refused("it is cut short"))?;
    content.truncate(end);
    if blake3::hash(&content) != hash {
        return Err(refused("it is damaged"));
    }
    Ok(content)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;
    use std::time::Duration;

    fn folder() -> (Folder, tempfile::TempDir) {
        let beside = tempfile::tempdir().unwrap();
        (Folder::new(&beside.path().join("a/b")).unwrap(), beside)
    }

    #[test]
    fn folder_and_files_are_their_users_alone() {
        let (folder, _beside) = folder();
        let name = named("x").finalize();
        folder.write(&name, b"content");
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
        folder.write(&name, b"content");
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
        folder.write(&name, b"content");
        assert_eq!(folder.read(&name).as_deref(), Some(&b"content"[..]));
    }

    #[test]
    fn a_file_that_others_could_have_written_is_not_used() {
        let (folder, beside) = folder();
        let name = named("x").finalize();
        folder.write(&name, b"content");
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
    fn room_is_made_by_throwing_away_what_was_unused_for_longest() {
        let (folder, _beside) = folder();
        let names: Vec<blake3::Hash> = (0..4).map(|i| named(&format!("{i}")).finalize()).collect();
        for (age, name) in (0..).zip(&names) {
            folder.write(name, &[0; 10 - HASH % 10]);
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
