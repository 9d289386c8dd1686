//! Files that are either there whole or not there: written beside their place, then renamed into it.

use anyhow::{Context, Result};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// Lets `write` fill a temporary file in the folder of `path`, then moves it to `path`. If `write` fails, or the
/// process ends before the move, nothing is left at `path` (a process that is killed may leave the temporary file).
///
/// The temporary name keeps the extension, for writers that choose the format by it.
pub fn write_with(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    // A result is for everyone whom the folder lets in.
    place(path, 0o644, write)
}

/// Writes bytes as [`write_with`] does.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_with(path, |temporary| Ok(File::create(temporary)?.write_all(bytes)?))
}

/// Writes a secret as [`write_with`] does, readable by its owner alone from the first moment on.
pub fn write_secret(path: &Path, secret: &[u8]) -> Result<()> {
    place(path, 0o600, |temporary| Ok(File::options().write(true).open(temporary)?.write_all(secret)?))
}

fn place(path: &Path, mode: u32, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
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
        .with_context(|| format!("cannot write in the folder {}", folder.display()))?
        .into_temp_path();
    write(&temporary).with_context(|| format!("cannot write {}", path.display()))?;
    File::open(&temporary)
        .and_then(|f| f.sync_all())
        .with_context(|| format!("cannot write {}", path.display()))?;
    // Temporary files are made for their owner alone.
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
