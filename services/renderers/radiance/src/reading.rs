//! Whether text can be read that Radiance's programs and files have. Nothing is started.

use crate::rif::Plan;
use crate::settings::Arguments;
use crate::tree::Counter;
use crate::views::views_of;
use std::path::Path;

/// What `rad -n -e` prints.
///
/// # Errors
/// Why it cannot be read.
pub fn rad(text: &str) -> Result<(), String> {
    Plan::read(&text.lines().map(str::to_owned).collect::<Vec<_>>()).map(drop)
}

/// Options of rtrace or rpict.
///
/// # Errors
/// Why they cannot be read.
pub fn options(text: &str) -> Result<(), String> {
    Arguments::read(&text.split_whitespace().map(str::to_owned).collect::<Vec<_>>()).map(drop)
}

/// A file of views, or the header of a picture.
///
/// # Errors
/// Why it cannot be read.
pub fn views(path: &Path) -> Result<(), String> {
    views_of(path).map(drop)
}

/// Trees of rays, as rtrace prints them. Gives how many.
///
/// # Errors
/// The line that is not understood.
pub fn trees(bytes: &[u8]) -> Result<usize, String> {
    let mut reader = Counter { halves: true, most_specular: 16 }.reader();
    // As they come from a pipe: in pieces.
    bytes.chunks(7).try_for_each(|piece| reader.read(piece))?;
    Ok(reader.trees().len())
}
