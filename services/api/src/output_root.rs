//! The folder below which images are written, on storage that the studio shares.
//!
//! A file appears under its name only when it is whole. Files and folders have the root's own permissions, since
//! others read them, and the rest of the service writes for itself alone. Paths are opened through the root's own
//! handle, so neither `..` nor a symbolic link leads out of it.

use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use cap_std::ambient_authority;
use cap_std::fs::{Dir, Permissions, PermissionsExt as _};
use forelight_store::DueOutput;

/// The folder below which images are written.
#[derive(Clone, Debug)]
pub(crate) struct OutputRoot(Arc<Dir>);

impl OutputRoot {
    /// Opens the folder, which must exist.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self(Arc::new(Dir::open_ambient_dir(path, ambient_authority())?)))
    }

    /// Writes a file, and puts it under its name once it is on disk.
    pub async fn write(&self, output: &DueOutput, pieces: Vec<Bytes>) -> io::Result<()> {
        let (root, path) = (self.0.clone(), PathBuf::from(&output.path));
        let unfinished = format!(".{}.unfinished", output.content);
        let written = tokio::task::spawn_blocking(move || write(&root, &path, &unfinished, &pieces)).await;
        written.map_err(io::Error::other)?
    }
}

fn write(root: &Dir, path: &Path, unfinished: &str, pieces: &[Bytes]) -> io::Result<()> {
    let folder = path.parent().map_or_else(PathBuf::new, Path::to_owned);
    let mode = root.dir_metadata()?.permissions().mode();
    make_folders(root, &folder, mode)?;
    let unfinished = folder.join(unfinished);
    let whole = (|| {
        let mut file = root.create(&unfinished)?;
        pieces.iter().try_for_each(|piece| file.write_all(piece))?;
        file.set_permissions(Permissions::from_mode(mode & 0o666))?;
        file.sync_all()?;
        root.rename(&unfinished, root, path)
    })();
    if whole.is_err() {
        // What is left of it would be in the way.
        let _ = root.remove_file(&unfinished);
    }
    whole
}

/// Makes a folder and those that it is in, as far as they are missing, with these permissions.
fn make_folders(root: &Dir, folder: &Path, mode: u32) -> io::Result<()> {
    let mut above: Vec<&Path> = folder.ancestors().filter(|path| !path.as_os_str().is_empty()).collect();
    above.reverse();
    for path in above {
        match root.create_dir(path) {
            Ok(()) => root.set_permissions(path, Permissions::from_mode(mode & 0o7777))?,
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
