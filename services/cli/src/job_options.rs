//! Flags of several commands that say what a job, or a frame, is to come to.

use std::path::PathBuf;

/// A picture to write.
pub fn png_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(end) if end.eq_ignore_ascii_case("png") => Ok(path),
        _ => Err("it will be a PNG, so the name must end in .png".into()),
    }
}
