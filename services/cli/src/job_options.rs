//! Options that several commands share.

use forelight_protocol::Timestamp;
use forelight_terminal::failure::BadInput;
use forelight_terminal::quantities::Deadline;
use std::path::PathBuf;

/// The instant of a deadline that was typed now, if one was.
///
/// # Errors
/// If it is beyond the calendar.
pub fn deadline(typed: Option<Deadline>, now: jiff::Timestamp) -> Result<Option<Timestamp>, BadInput> {
    let instant = typed.map(|typed| typed.instant(now)).transpose();
    let instant = instant.map_err(|reason| BadInput::new(format!("--deadline: {reason}")))?;
    Ok(instant.map(|instant| Timestamp::from_micros(instant.as_microsecond())))
}

/// Parses the name of a PNG file to write.
pub fn png_file(text: &str) -> Result<PathBuf, String> {
    file_with_ending(text, "a PNG", "png")
}

/// Parses the name of an SVG file to write.
pub fn svg_file(text: &str) -> Result<PathBuf, String> {
    file_with_ending(text, "an SVG", "svg")
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
