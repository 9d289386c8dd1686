//! Scene bundles to send to the service.

use crate::repository;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// A bundle in `deploy/scenes`.
pub fn shipped(name: &str) -> PathBuf {
    repository().join("deploy/scenes").join(name)
}

/// A folder as a zip file.
pub fn zipped(folder: &Path) -> Vec<u8> {
    let mut files = Vec::new();
    collect(folder, "", &mut files);
    files.sort();
    let contents = files.iter().map(|(name, path)| {
        (name.as_str(), std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
    });
    zip_of(contents)
}

/// A zip file of these files.
pub fn zip_of<'a>(files: impl IntoIterator<Item = (&'a str, Vec<u8>)>) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        zip.start_file(name, SimpleFileOptions::default()).expect("a new file can be started");
        zip.write_all(&content).expect("memory can be written to");
    }
    zip.finish().expect("the end can be written").into_inner()
}

fn collect(folder: &Path, prefix: &str, files: &mut Vec<(String, PathBuf)>) {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    for entry in entries.map(|entry| entry.expect("the folder can be read")) {
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            collect(&entry.path(), &format!("{name}/"), files);
        } else {
            files.push((name, entry.path()));
        }
    }
}
