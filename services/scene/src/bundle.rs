//! Reads the folder or archive that holds a scene.
//!
//! Hazards: a path, or a symbolic link, could lead out of the bundle, and an archive could expand beyond
//! memory. So every path is checked, and every read against [`Limits`].

use crate::error::SceneError;
use crate::limits::{Limits, RATIO_MATTERS_FROM};
use crate::regular_file::open_regular;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// A readable bundle: a folder or a `.zip` file, with relative paths that use `/`. A `.zip` may have one
/// folder around everything.
pub struct Bundle {
    name: String,
    /// Canonical path of the folder or archive.
    place: PathBuf,
    store: Store,
    limits: Limits,
    usage: Mutex<Usage>,
}

enum Store {
    /// The folder's canonical path.
    Folder(PathBuf),
    Archive {
        /// The same file as in `archive`, for its content as it is.
        file: File,
        archive: Mutex<ZipArchive<BufReader<File>>>,
        /// Entry number by path.
        index: BTreeMap<String, usize>,
    },
}

/// What was read so far: the hash of each file, and the total number of bytes.
#[derive(Default)]
struct Usage {
    bytes: u64,
    files: BTreeMap<String, blake3::Hash>,
}

impl Bundle {
    /// Opens a folder or a `.zip` file. Fails if `path` is neither, or if an archive is damaged, too large or
    /// encrypted, holds a symbolic link, or has a path that leaves it.
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, SceneError> {
        let shown = path.display().to_string();
        let io = |source| SceneError::Io { file: shown.clone(), source };
        let canonical = path.canonicalize().map_err(io)?;
        let own_name = if canonical.is_dir() { canonical.file_name() } else { canonical.file_stem() };
        let name = own_name.map_or_else(|| "scene".to_owned(), |own| own.to_string_lossy().into_owned());
        let store = if canonical.is_dir() {
            Store::Folder(canonical.clone())
        } else {
            let file = open_regular(&canonical).map_err(io)?;
            open_archive(&shown, file, limits)?
        };
        Ok(Self { name, place: canonical, store, limits: *limits, usage: Mutex::default() })
    }

    /// Name of the folder or archive, without extension.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Canonical path of the folder or archive.
    pub(crate) fn place(&self) -> &Path {
        &self.place
    }

    /// The limits that the bundle was opened with.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Returns `true` if the bundle has a file at `path`.
    pub fn contains(&self, path: &str) -> bool {
        match &self.store {
            Store::Folder(root) => check_inside(path).is_ok() && root.join(path).is_file(),
            Store::Archive { index, .. } => index.contains_key(path),
        }
    }

    /// Names of the files at the top level, sorted. Fails if the folder cannot be listed.
    pub fn top_level(&self) -> Result<Vec<String>, SceneError> {
        let mut names = Vec::new();
        match &self.store {
            Store::Folder(root) => {
                let io = |source| SceneError::Io { file: self.name.clone(), source };
                for entry in root.read_dir().map_err(io)?.take(self.limits.entries) {
                    let entry = entry.map_err(io)?;
                    if let (Ok(name), true) = (entry.file_name().into_string(), entry.path().is_file()) {
                        names.push(name);
                    }
                }
                names.sort_unstable();
            }
            Store::Archive { index, .. } => names.extend(index.keys().filter(|p| !p.contains('/')).cloned()),
        }
        Ok(names)
    }

    /// Reads a whole file. Fails if the path leaves the bundle (also through a symbolic link), is not a file,
    /// or exceeds a limit.
    pub fn read(&self, path: &str) -> Result<Vec<u8>, SceneError> {
        check_inside(path).map_err(|reason| SceneError::file(path, format!("the path {reason}")))?;
        let bytes = match &self.store {
            Store::Folder(root) => self.read_from_folder(root, path)?,
            Store::Archive { archive, index, .. } => {
                let at = *index.get(path).ok_or_else(|| missing(path))?;
                self.read_from_archive(&mut archive.lock(), path, at)?
            }
        };
        let mut usage = self.usage.lock();
        usage.bytes += bytes.len() as u64;
        self.check(path, "bytes read from the bundle", usage.bytes, self.limits.total_bytes)?;
        if !usage.files.contains_key(path) {
            usage.files.insert(path.to_owned(), blake3::hash(&bytes));
        }
        self.check(path, "files in the bundle", usage.files.len() as u64, self.limits.entries as u64)?;
        Ok(bytes)
    }

    /// Counts bytes that `file` expands to by a compression of its own. Fails if the bundle's files become
    /// too large.
    pub(crate) fn count_expanded(&self, file: &str, bytes: u64) -> Result<(), SceneError> {
        let mut usage = self.usage.lock();
        usage.bytes = usage.bytes.saturating_add(bytes);
        self.check(file, "bytes read from the bundle", usage.bytes, self.limits.total_bytes)
    }

    /// BLAKE3 hash of paths and contents of all files read so far, the same for a folder and its archive.
    pub fn digest(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        for (path, hash) in &self.usage.lock().files {
            hasher.update(&(path.len() as u64).to_le_bytes());
            hasher.update(path.as_bytes());
            hasher.update(hash.as_bytes());
        }
        *hasher.finalize().as_bytes()
    }

    /// Number of bytes read so far, after expansion.
    pub(crate) fn bytes_read(&self) -> u64 {
        self.usage.lock().bytes
    }

    /// Paths of the files read so far.
    pub(crate) fn files_read(&self) -> Vec<String> {
        self.usage.lock().files.keys().cloned().collect()
    }

    /// Hash of the content read so far: of an archive, the whole of it. `None` if it cannot be read.
    pub(crate) fn content_read(&self) -> Option<[u8; 32]> {
        match &self.store {
            Store::Folder(_) => Some(self.digest()),
            Store::Archive { file, .. } => hash_of(file).ok(),
        }
    }

    /// [`Self::content_read`] after reading `files` of a folder. `None` if one cannot be read.
    pub(crate) fn content_of(&self, files: &[String]) -> Option<[u8; 32]> {
        if let Store::Folder(_) = self.store {
            let read = forelight_threads::map(files, 1, |file| self.read(file).map(drop));
            read.into_iter().collect::<Result<(), SceneError>>().ok()?;
        }
        self.content_read()
    }

    fn read_from_folder(&self, root: &Path, path: &str) -> Result<Vec<u8>, SceneError> {
        let io = |source| SceneError::Io { file: path.to_owned(), source };
        let real = root.join(path).canonicalize().map_err(io)?;
        if !real.starts_with(root) {
            return Err(SceneError::file(path, "a symbolic link leads out of the bundle"));
        }
        let file = open_regular(&real).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        self.check(path, "bytes", length, self.limits.file_bytes)?;
        let mut bytes = Vec::with_capacity(length as usize);
        // The file may grow while it is read, so check the bytes that were read as well.
        file.take(self.limits.file_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(io)?;
        self.check(path, "bytes", bytes.len() as u64, self.limits.file_bytes)?;
        Ok(bytes)
    }

    fn read_from_archive(
        &self,
        archive: &mut ZipArchive<BufReader<File>>,
        path: &str,
        at: usize,
    ) -> Result<Vec<u8>, SceneError> {
        let damaged = |e: &dyn std::fmt::Display| SceneError::file(path, format!("cannot be expanded: {e}"));
        let entry = archive.by_index(at).map_err(|e| damaged(&e))?;
        // The sizes in an archive's directory may be false. Check the bytes that were actually expanded.
        let (compressed, allowed) = (entry.compressed_size(), entry.size().min(self.limits.file_bytes));
        let mut bytes = Vec::new();
        entry.take(allowed.saturating_add(1)).read_to_end(&mut bytes).map_err(|e| damaged(&e))?;
        self.check(path, "expanded bytes", bytes.len() as u64, allowed)?;
        check_ratio(path, bytes.len() as u64, compressed, &self.limits)?;
        Ok(bytes)
    }

    fn check(&self, file: &str, what: &'static str, found: u64, limit: u64) -> Result<(), SceneError> {
        if found > limit {
            return Err(SceneError::Limit { file: file.to_owned(), what, found, limit });
        }
        Ok(())
    }
}

impl std::fmt::Debug for Bundle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bundle").field("name", &self.name).finish_non_exhaustive()
    }
}

/// BLAKE3 hash of a whole file, wherever it is being read.
fn hash_of(file: &File) -> io::Result<[u8; 32]> {
    let (mut hasher, mut buffer, mut offset) = (blake3::Hasher::new(), vec![0; 1 << 18], 0);
    loop {
        let read = file.read_at(&mut buffer, offset)?;
        if read == 0 {
            return Ok(*hasher.finalize().as_bytes());
        }
        hasher.update(&buffer[..read]);
        offset += read as u64;
    }
}

fn missing(path: &str) -> SceneError {
    SceneError::Io { file: path.to_owned(), source: std::io::ErrorKind::NotFound.into() }
}

fn check_ratio(file: &str, expanded: u64, compressed: u64, limits: &Limits) -> Result<(), SceneError> {
    let ratio = expanded / compressed.max(1);
    if expanded > RATIO_MATTERS_FROM && ratio > limits.compression_ratio {
        return Err(SceneError::Limit {
            file: file.to_owned(),
            what: "expanded bytes for each compressed byte",
            found: ratio,
            limit: limits.compression_ratio,
        });
    }
    Ok(())
}

/// Reads the archive's directory. Rejects every entry that must not be expanded, before any is.
fn open_archive(shown: &str, file: File, limits: &Limits) -> Result<Store, SceneError> {
    let whole = file.try_clone().map_err(|source| SceneError::Io { file: shown.to_owned(), source })?;
    let mut archive = ZipArchive::new(BufReader::new(file))
        .map_err(|e| SceneError::file(shown, no_archive(shown, &whole, &e.to_string())))?;
    if archive.len() > limits.entries {
        let (found, limit) = (archive.len() as u64, limits.entries as u64);
        return Err(SceneError::Limit { file: shown.to_owned(), what: "archive entries", found, limit });
    }
    let mut index = BTreeMap::new();
    let mut total = 0u64;
    for at in 0..archive.len() {
        let entry = archive
            .by_index_raw(at)
            .map_err(|e| SceneError::file(shown, format!("entry {at} of the archive is damaged: {e}")))?;
        let path = std::str::from_utf8(entry.name_raw())
            .map_err(|_| SceneError::file(shown, format!("the name of archive entry {at} is not UTF-8")))?;
        let file = format!("{shown}/{path}");
        // Some programs start every path with `./`. macOS adds a folder with its own metadata.
        let path = path.strip_prefix("./").unwrap_or(path);
        if path.is_empty() || path.starts_with("__MACOSX/") {
            continue;
        }
        if entry.is_symlink() {
            return Err(SceneError::file(file, "symbolic links are not allowed in an archive"));
        }
        check_inside(path.strip_suffix('/').unwrap_or(path))
            .map_err(|reason| SceneError::file(&file, format!("the archive entry {reason}")))?;
        if entry.is_dir() {
            continue;
        }
        if entry.encrypted() {
            return Err(SceneError::file(file, "the archive entry is encrypted"));
        }
        if entry.size() > limits.file_bytes {
            let (found, limit) = (entry.size(), limits.file_bytes);
            return Err(SceneError::Limit { file, what: "expanded bytes", found, limit });
        }
        check_ratio(&file, entry.size(), entry.compressed_size(), limits)?;
        total = total.saturating_add(entry.size());
        if total > limits.total_bytes {
            let (what, limit) = ("expanded bytes of the archive", limits.total_bytes);
            return Err(SceneError::Limit { file: shown.to_owned(), what, found: total, limit });
        }
        if index.insert(path.to_owned(), at).is_some() {
            return Err(SceneError::file(file, "the archive has two entries of this name"));
        }
    }
    Ok(Store::Archive { file: whole, archive: Mutex::new(archive), index: without_common_folder(index) })
}

/// Why a file is no bundle, and what to do. `error` says why it is no archive.
fn no_archive(shown: &str, file: &File, error: &str) -> String {
    const READ: &str =
        "this program reads a .glb or .gltf file, a folder with a `scene.json`, or a .zip of one";
    let mut start = [0; 64];
    let length = file.read_at(&mut start, 0).unwrap_or(0);
    let start = start[..length].trim_ascii_start();
    let extension = Path::new(shown).extension().map(|e| e.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        // What was uploaded has no extension of its own.
        _ if start.starts_with(b"glTF") || start.starts_with(b"{") => {
            "is a single glTF or JSON file; put it into a folder, with the files that it names".into()
        }
        Some("obj") => "is a single .obj file; put it into a folder with a `scene.json` that names it".into(),
        Some("zip") => format!("is neither a folder nor a readable .zip: {error}"),
        Some(extension) => format!("is a .{extension} file; {READ}"),
        None => format!("is neither a folder nor a readable .zip; {READ}"),
    }
}

/// Removes the folder around everything, if there is one, as zipping a folder often adds it.
fn without_common_folder(index: BTreeMap<String, usize>) -> BTreeMap<String, usize> {
    let common =
        index.keys().next().and_then(|first| first.split_once('/')).map(|(folder, _)| format!("{folder}/"));
    match common {
        Some(folder) if index.keys().all(|path| path.starts_with(&folder)) => {
            index.into_iter().map(|(path, at)| (path[folder.len()..].to_owned(), at)).collect()
        }
        _ => index,
    }
}

/// Checks that a path is relative, uses only `/`, and has no empty, `.` or `..` component. Returns the reason
/// otherwise.
fn check_inside(path: &str) -> Result<(), &'static str> {
    if path.contains(['\\', ':', '\0']) {
        return Err(
            "has a character that names in a bundle may not have (`:`, `\\` or NUL); rename the file",
        );
    }
    if path.split('/').any(|part| matches!(part, "" | "." | "..")) {
        return Err("is outside the bundle");
    }
    Ok(())
}

/// Resolves `reference`, used in the file `from`, to a path in the bundle, relative to that file's folder.
/// Fails if the reference is empty or absolute, uses `\`, a drive or a scheme, or leaves the bundle.
pub(crate) fn resolve(from: &str, reference: &str) -> Result<String, String> {
    if reference.is_empty() {
        return Err("the path is empty".into());
    }
    if reference.contains('\\') {
        return Err(format!("`{reference}`: a path in a bundle is written with `/`"));
    }
    if reference.starts_with('/') || reference.contains([':', '\0']) {
        return Err(format!("`{reference}`: a path in a bundle is relative"));
    }
    let mut parts: Vec<&str> =
        from.rsplit_once('/').map_or_else(Vec::new, |(folder, _)| folder.split('/').collect());
    for part in reference.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.pop().is_none() => return Err(format!("`{reference}` leaves the bundle")),
            ".." => {}
            _ => parts.push(part),
        }
    }
    Ok(parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_resolve_relative_to_the_file_that_names_them() {
        assert_eq!(resolve("scene.mtl", "textures/wood.jpg").as_deref(), Ok("textures/wood.jpg"));
        assert_eq!(resolve("models/a.gltf", "../textures/./wood.jpg").as_deref(), Ok("textures/wood.jpg"));
        assert_eq!(resolve("models/a.gltf", "a.bin").as_deref(), Ok("models/a.bin"));
    }

    #[test]
    fn references_that_leave_the_bundle_are_refused() {
        for bad in ["", "../x", "a/../../x", "/etc/passwd", "C:/x", "a\\b", "file:x", "a\0b"] {
            assert!(resolve("scene.json", bad).is_err(), "{bad:?} was accepted");
        }
    }
}
