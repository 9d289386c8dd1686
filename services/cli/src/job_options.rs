//! Options that several commands share.

use std::path::PathBuf;

/// Parses the name of a PNG file to write.
pub fn png_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(end) if end.eq_ignore_ascii_case("png") => Ok(path),
        _ => Err("the file is a PNG, so its name must end in .png".into()),
    }
}
