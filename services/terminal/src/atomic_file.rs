//! Files that are written completely or not at all: first to a temporary file, then renamed. Links stay
//! links, and their targets are written. Pipes and devices take the bytes directly.

use crate::failure::BadInput;
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Lets `write` fill a temporary file next to `path`, then renames it to `path`. If this fails, `path` is
/// unchanged. A killed process may leave the temporary file.
///
/// The temporary name has the same extension, for writers that choose the format by it.
pub fn write_with(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    // A result is readable by everyone who can enter the folder.
    place(path, 0o644, write)
}

/// Writes bytes as [`write_with`] does.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_with(path, |temporary| Ok(File::create(temporary)?.write_all(bytes)?))
}

/// Writes a secret as [`write_with`] does. Only its owner can ever read it.
pub fn write_secret(path: &Path, secret: &[u8]) -> Result<()> {
    place(path, 0o600, |temporary| Ok(File::options().write(true).open(temporary)?.write_all(secret)?))
}

/// Checks before the work that its files can be written. Leaves nothing behind.
///
/// # Errors
/// If a path is a folder or write-protected, its folder cannot be written, or two paths are the same.
pub fn check<'a>(paths: impl IntoIterator<Item = Option<&'a Path>>) -> Result<()> {
    let mut seen: BTreeSet<PathBuf> = BTreeSet::new();
    for path in paths.into_iter().flatten() {
        let target = target(path)?;
        if matches!(target.kind, Kind::File) {
            let there = target.folder().ancestors().find(|folder| fs::symlink_metadata(folder).is_ok());
            let there = there.filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            tempfile::tempfile_in(there).map_err(|error| {
                let error = without_temporary_name(error);
                refused(path, &format!("nothing can be written in {}: {error}", there.display()))
            })?;
        }
        if !seen.insert(target.path) {
            return Err(refused(path, "two outputs have this path; name different files").into());
        }
    }
    Ok(())
}

fn refused(path: &Path, reason: &str) -> BadInput {
    BadInput::new(format!("cannot write {}: {reason}", path.display()))
}

/// The error of the system. That of a temporary file ends with its name, which says nothing to people.
fn without_temporary_name(error: io::Error) -> io::Error {
    let text = error.to_string();
    let reason = text.split(" at path ").next().unwrap_or_default();
    io::Error::new(error.kind(), reason)
}

struct Target {
    path: PathBuf,
    kind: Kind,
}

enum Kind {
    /// A file, or nothing yet.
    File,
    /// A pipe or a device.
    Special,
}

impl Target {
    fn folder(&self) -> &Path {
        let parent = self.path.parent().filter(|parent| !parent.as_os_str().is_empty());
        parent.unwrap_or(Path::new("."))
    }
}

fn target(path: &Path) -> Result<Target> {
    // A path that does not exist yet is kept as it is.
    let path =
        if path.is_symlink() { &*fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()) } else { path };
    let found = |kind| Ok(Target { path: path.to_owned(), kind });
    match fs::metadata(path) {
        Ok(about) if about.is_dir() => Err(refused(path, "it is a folder; name a file in it").into()),
        Ok(about) if !about.is_file() => found(Kind::Special),
        Ok(about) if about.permissions().readonly() => Err(refused(path, "it is write-protected").into()),
        _ => found(Kind::File),
    }
}

fn place(path: &Path, mode: u32, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    let target = target(path)?;
    let (path, folder) = (&*target.path, target.folder());
    if matches!(target.kind, Kind::Special) {
        let elsewhere =
            tempfile::NamedTempFile::new().context("cannot write a temporary file")?.into_temp_path();
        write(&elsewhere).with_context(|| format!("cannot write {}", path.display()))?;
        let through = || {
            let mut into = File::options().write(true).open(path)?;
            io::copy(&mut File::open(&elsewhere)?, &mut into)
        };
        return through().map(drop).with_context(|| format!("cannot write {}", path.display()));
    }
    fs::create_dir_all(folder).with_context(|| format!("cannot create the folder {}", folder.display()))?;
    let mut suffix = OsString::from(".part");
    if let Some(extension) = path.extension() {
        suffix.push(".");
        suffix.push(extension);
    }
    let temporary = tempfile::Builder::new()
        .prefix(".forelight-")
        .suffix(&suffix)
        .tempfile_in(folder)
        .map_err(without_temporary_name)
        .with_context(|| format!("cannot write in the folder {}", folder.display()))?
        .into_temp_path();
    write(&temporary).with_context(|| format!("cannot write {}", path.display()))?;
    File::open(&temporary)
        .and_then(|f| f.sync_all())
        .with_context(|| format!("cannot write {}", path.display()))?;
    // Temporary files are readable by their owner only.
    fs::set_permissions(&temporary, fs::Permissions::from_mode(mode))
        .with_context(|| format!("cannot set the permissions of {}", path.display()))?;
    temporary.persist(path).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_for_its_owner_and_a_result_for_everyone() {
        let dir = tempfile::tempdir().unwrap();
        let mode = |name: &str| fs::metadata(dir.path().join(name)).unwrap().permissions().mode() & 0o777;
        write_secret(&dir.path().join("secret"), b"x").unwrap();
        write_bytes(&dir.path().join("result"), b"x").unwrap();
        assert_eq!((mode("secret"), mode("result")), (0o600, 0o644));
    }

    #[test]
    fn links_stay_links_and_pipes_pipes() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link, pipe) = (dir.path().join("file"), dir.path().join("link"), dir.path().join("pipe"));
        write_bytes(&file, b"old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_bytes(&link, b"new").unwrap();
        assert!(link.is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read(pipe).unwrap()
        });
        write_bytes(&pipe, b"through").unwrap();
        assert_eq!(reader.join().unwrap(), b"through");
        check([Some(&*pipe), Some(&*link)]).unwrap();
    }

    #[test]
    fn what_cannot_be_written_is_said_beforehand_and_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        write_bytes(&path("file"), b"x").unwrap();
        write_bytes(&path("kept"), b"x").unwrap();
        fs::set_permissions(path("kept"), fs::Permissions::from_mode(0o444)).unwrap();
        check([Some(&*path("new/folders/a.png")), None, Some(&*path("file"))]).unwrap();
        let said = |paths: &[PathBuf]| check(paths.iter().map(|path| Some(&**path))).unwrap_err().to_string();
        assert!(said(&[dir.path().to_owned()]).contains("name a file in it"));
        assert!(said(&[path("kept")]).contains("write-protected"));
        assert!(said(&[path("file/a.png")]).contains("nothing can be written in"));
        assert!(said(&[PathBuf::from("/proc/a.png")]).contains("nothing can be written in /proc"));
        assert!(said(&[path("a.png"), path("a.png")]).contains("two outputs"));
        assert!(write_bytes(&path("kept"), b"y").is_err());
        let nowhere = format!("{:#}", write_bytes(Path::new("/proc/a.png"), b"x").unwrap_err());
        assert!(nowhere.contains("/proc") && !nowhere.contains(".forelight-"), "{nowhere}");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        write_bytes(&path, b"old").unwrap();
        let failed = write_with(&path, |temporary| {
            assert_eq!(temporary.extension().unwrap(), "exr");
            fs::write(temporary, "half")?;
            anyhow::bail!("stopped")
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
