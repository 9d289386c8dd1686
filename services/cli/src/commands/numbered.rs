//! Names of files with the frame's number: `images/####.exr`.

use forelight_terminal::failure::BadInput;
use std::path::{Path, PathBuf};

/// The path with the frame's number in place of the last row of `#` in its name. The number has as many digits
/// as the row, or more if it is greater.
///
/// # Errors
/// If the name has no `#`: all frames would be written to one file.
pub fn numbered(flag: &str, path: &Path, frame: i64) -> Result<PathBuf, BadInput> {
    let unusable = |why: &str| {
        let hint = "#### becomes the frame's number, as in images/####.exr";
        BadInput::new(format!("{flag} {}: {why}", path.display())).hint(hint)
    };
    let name = path.file_name().and_then(|name| name.to_str());
    let name = name.ok_or_else(|| unusable("the name is not valid Unicode"))?;
    let end = name.rfind('#').ok_or_else(|| unusable("with --frames, the name must hold a #"))? + 1;
    let start = name[..end].trim_end_matches('#').len();
    let digits = end - start;
    Ok(path.with_file_name(format!("{}{frame:0digits$}{}", &name[..start], &name[end..])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_row_of_marks_is_the_number() {
        for (name, frame, expected) in [
            ("####.exr", 12, "0012.exr"),
            ("a/#/shot.#.exr", 12, "a/#/shot.12.exr"),
            ("take#2_###.png", 7, "take#2_007.png"),
            ("##.exr", 12_345, "12345.exr"),
            ("####.exr", -3, "-003.exr"),
        ] {
            assert_eq!(numbered("--out", Path::new(name), frame).unwrap(), Path::new(expected));
        }
        let error = numbered("--stats", Path::new("a/#/frame.json"), 0).unwrap_err().to_string();
        assert!(
            error.starts_with("--stats a/#/frame.json: with --frames, the name must hold a #"),
            "{error}"
        );
    }
}
