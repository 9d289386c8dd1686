//! Options that several commands share.

use std::path::PathBuf;

/// Parses the name of a PNG file to write.
pub fn png_file(text: &str) -> Result<PathBuf, String> {
    file_with_ending(text, "a PNG", "png")
}

/// Parses the name of an MP4 file to write.
pub fn mp4_file(text: &str) -> Result<PathBuf, String> {
    file_with_ending(text, "an MP4", "mp4")
}

fn file_with_ending(text: &str, what: &str, ending: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(end) if end.eq_ignore_ascii_case(ending) => Ok(path),
        _ => Err(format!("the file is {what}, so its name must end in .{ending}")),
    }
}
