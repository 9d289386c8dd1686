//! Reads files that the user names, up to a size.

use crate::failure::BadInput;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Reads a file, pipe or device of at most `most` bytes.
///
/// # Errors
/// Names the file and the reason.
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>, BadInput> {
    let wrong = |why: String| BadInput::new(format!("{}: {why}", path.display()));
    let too_large = || wrong(format!("it is too large: more than {most} bytes"));
    let file = File::open(path).map_err(|error| wrong(error.to_string()))?;
    // The length of a device or a pipe is 0. That of a file saves reading it.
    if file.metadata().is_ok_and(|known| known.len() > most) {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    file.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(|error| wrong(error.to_string()))?;
    if bytes.len() as u64 > most { Err(too_large()) } else { Ok(bytes) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_too_large_is_refused_whether_or_not_it_says_how_large_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x");
        std::fs::write(&path, b"four").unwrap();
        assert_eq!(read(&path, 4).unwrap(), b"four");
        for path in [&path, Path::new("/dev/zero")] {
            let error = read(path, 3).unwrap_err().to_string();
            assert!(error.contains("more than 3 bytes") && error.contains(path.to_str().unwrap()), "{error}");
        }
        let sparse = File::create(dir.path().join("sparse")).unwrap();
        sparse.set_len(1 << 40).unwrap();
        assert!(read(&dir.path().join("sparse"), 1 << 30).is_err());
        assert!(read(dir.path(), 4).is_err() && read(&dir.path().join("none"), 4).is_err());
    }
}
