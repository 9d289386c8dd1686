//! Packs a bundle into one zip file. The bytes depend only on the names and contents of the files.
//!
//! Entries are in byte order of their paths, with fixed times and permissions. So the same folder has the
//! same hash on every machine, and the service stores it once.

use anyhow::{Context, Result};
use forelight_scene::open_regular;
use forelight_terminal::failure::BadInput;
use std::fs;
use std::io::{self, Seek, Write};
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Entries above this size are written in the zip64 form.
const ZIP64_FROM: u64 = u32::MAX as u64;

/// Writes `folder` as a zip to `target`, without hidden files (leading dot).
pub fn pack<W: Write + Seek>(folder: &Path, target: W) -> Result<W> {
    let mut files = Vec::new();
    collect(folder, "", &mut files)?;
    if files.is_empty() {
        return Err(BadInput::new(format!("{}: the folder holds no files", folder.display())).into());
    }
    pack_files(files, target)
}

/// Writes files, by their names in the archive, as a zip to `target`.
pub fn pack_files<W: Write + Seek>(mut files: Vec<(String, PathBuf)>, target: W) -> Result<W> {
    files.sort();
    let mut zip = ZipWriter::new(target);
    for (name, path) in files {
        let mut source = open_regular(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let large = source.metadata()?.len() >= ZIP64_FROM;
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(6))
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            .large_file(large);
        zip.start_file(&name, options).with_context(|| format!("cannot pack {name}"))?;
        io::copy(&mut source, &mut zip).with_context(|| format!("cannot pack {}", path.display()))?;
    }
    Ok(zip.finish()?)
}

/// Adds the regular files below `folder`, with paths relative to the bundle and `/` as separator.
fn collect(folder: &Path, prefix: &str, files: &mut Vec<(String, PathBuf)>) -> Result<()> {
    let entries =
        fs::read_dir(folder).with_context(|| format!("cannot read the folder {}", folder.display()))?;
    for entry in entries {
        let entry = entry.with_context(|| format!("cannot read the folder {}", folder.display()))?;
        let path = entry.path();
        let Some(name) = entry.file_name().to_str().map(str::to_owned) else {
            return Err(
                BadInput::new(format!("{}: file names in a bundle must be UTF-8", path.display())).into()
            );
        };
        if name.starts_with('.') {
            continue;
        }
        let kind = entry.file_type().with_context(|| format!("cannot read {}", path.display()))?;
        if kind.is_symlink() {
            return Err(BadInput::new(format!("{}: a bundle may not hold links", path.display()))
                .hint("replace the link with the file that it points to")
                .into());
        }
        let relative = format!("{prefix}{name}");
        if kind.is_dir() {
            collect(&path, &format!("{relative}/"), files)?;
        } else if kind.is_file() {
            files.push((relative, path));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Cursor, Read};

    fn folder(order: &[&str]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("textures")).unwrap();
        for name in order {
            fs::write(dir.path().join(name), name.repeat(100)).unwrap();
        }
        dir
    }

    fn packed(folder: &Path) -> Vec<u8> {
        pack(folder, Cursor::new(Vec::new())).unwrap().into_inner()
    }

    #[test]
    fn the_same_folder_packs_to_the_same_bytes_whenever_and_in_whatever_order_it_was_written() {
        let names = ["scene.json", "a.obj", "textures/wood.jpg"];
        let first = folder(&names);
        std::thread::sleep(std::time::Duration::from_millis(20));
        let second = folder(&[names[2], names[1], names[0]]);
        fs::write(second.path().join(".DS_Store"), "x").unwrap();
        assert_eq!(packed(first.path()), packed(second.path()));
        fs::write(second.path().join("a.obj"), "v 0 0 0").unwrap();
        assert_ne!(packed(first.path()), packed(second.path()));
    }

    #[test]
    fn what_is_packed_comes_out_again() {
        let dir = folder(&["scene.json", "textures/wood.jpg"]);
        let mut zip = zip::ZipArchive::new(Cursor::new(packed(dir.path()))).unwrap();
        let names: Vec<String> = zip.file_names().map(str::to_owned).collect();
        assert_eq!(names, ["scene.json", "textures/wood.jpg"]);
        let mut text = String::new();
        zip.by_name("scene.json").unwrap().read_to_string(&mut text).unwrap();
        assert_eq!(text, "scene.json".repeat(100));
    }

    #[test]
    fn an_empty_folder_and_a_link_are_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let error = pack(dir.path(), Cursor::new(Vec::new())).unwrap_err().to_string();
        assert!(error.contains("no files"), "{error}");
        std::os::unix::fs::symlink("/etc/hostname", dir.path().join("scene.json")).unwrap();
        let error = pack(dir.path(), Cursor::new(Vec::new())).unwrap_err().to_string();
        assert!(error.contains("scene.json") && error.contains("links"), "{error}");
    }
}
