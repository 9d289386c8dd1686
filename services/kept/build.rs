//! Hashes the sources that decide what is kept: readers of scenes, builders of trees, and what they build on.

use std::fs;
use std::path::{Path, PathBuf};

fn main() {
    // As of now: the folder in which this program was compiled may be another one, or gone.
    let root = std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_else(|| panic!("run this by cargo"));
    let root = Path::new(&root).join("../..");
    let mut files =
        ["Cargo.lock", "Cargo.toml", "services/tracer/src/tree.rs"].map(|file| root.join(file)).to_vec();
    for folder in ["services/scene/src", "services/bvh/src"] {
        println!("cargo::rerun-if-changed={}", root.join(folder).display());
        add(&root.join(folder), &mut files);
    }
    files.sort();
    let mut hasher = blake3::Hasher::new();
    for file in &files {
        println!("cargo::rerun-if-changed={}", file.display());
        let content = fs::read(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        hasher.update(&(content.len() as u64).to_le_bytes()).update(&content);
    }
    println!("cargo::rustc-env=KEPT_SOURCES={}", hasher.finalize());
}

/// Adds all files in a folder.
fn add(folder: &Path, files: &mut Vec<PathBuf>) {
    let entries = fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    for path in entries.flatten().map(|entry| entry.path()) {
        if path.is_dir() {
            add(&path, files);
        } else {
            files.push(path);
        }
    }
}
