//! Opens files that others named.
//!
//! Hazard: opening a pipe waits until somebody writes to it, and a device may never end. So only regular files
//! are opened, without waiting.

use std::fs::{File, FileType, OpenOptions};
use std::io;
use std::os::unix::fs::{FileTypeExt as _, OpenOptionsExt as _};
use std::path::Path;

use rustix::fs::OFlags;

/// Opens a regular file for reading. Never waits for another process.
///
/// # Errors
/// If the file cannot be opened, or is a folder, pipe, socket or device.
pub fn open_regular(path: &Path) -> io::Result<File> {
    // Opening a device may do something to it, so it is looked at first.
    check(path.metadata()?.file_type())?;
    open(path, OFlags::NONBLOCK)
}

/// The same, of the file itself.
///
/// # Errors
/// As [`open_regular`], and if it is a link.
pub fn open_no_link(path: &Path) -> io::Result<File> {
    check(path.symlink_metadata()?.file_type())?;
    open(path, OFlags::NONBLOCK | OFlags::NOFOLLOW)
}

fn open(path: &Path, flags: OFlags) -> io::Result<File> {
    let file = OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path)?;
    // Another file may have taken its place meanwhile.
    check(file.metadata()?.file_type())?;
    Ok(file)
}

fn check(kind: FileType) -> io::Result<()> {
    let what = if kind.is_file() {
        return Ok(());
    } else if kind.is_dir() {
        "a folder"
    } else if kind.is_symlink() {
        "a link"
    } else if kind.is_fifo() {
        "a pipe"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    };
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("it is {what}, not a regular file")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{CWD, FileType as Kind, Mode, mknodat};
    use std::os::unix::net::UnixListener;

    #[test]
    fn what_is_not_a_regular_file_is_refused_by_name_and_nothing_waits() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("file"), "content").unwrap();
        assert_eq!(io::read_to_string(open_regular(&path("file")).unwrap()).unwrap(), "content");
        mknodat(CWD, path("pipe"), Kind::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        let _socket = UnixListener::bind(path("socket")).unwrap();
        std::os::unix::fs::symlink(path("pipe"), path("link")).unwrap();
        let devices = ["/dev/zero", "/dev/tty"].map(Path::new);
        for (found, what) in [
            (path("pipe"), "a pipe"),
            (path("link"), "a pipe"),
            (path("socket"), "a socket"),
            (folder.path().to_owned(), "a folder"),
            (devices[0].to_owned(), "a device"),
            (devices[1].to_owned(), "a device"),
        ] {
            let error = open_regular(&found).unwrap_err().to_string();
            assert_eq!(error, format!("it is {what}, not a regular file"), "{}", found.display());
        }
        std::os::unix::fs::symlink(path("file"), path("link to the file")).unwrap();
        assert!(open_regular(&path("link to the file")).is_ok() && open_no_link(&path("file")).is_ok());
        for (name, what) in [("link to the file", "a link"), ("pipe", "a pipe")] {
            let error = open_no_link(&path(name)).unwrap_err().to_string();
            assert_eq!(error, format!("it is {what}, not a regular file"));
        }
    }
}
