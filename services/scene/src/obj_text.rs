//! The text of OBJ and MTL files: encoding, continued lines and comments.

use crate::error::SceneError;
use std::borrow::Cow;

/// The text of a file, with continued lines joined. If it is not UTF-8, the error has the line.
pub(crate) fn text<'a>(file: &str, bytes: &'a [u8]) -> Result<Cow<'a, str>, SceneError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let text = std::str::from_utf8(bytes).map_err(|e| {
        let line = 1 + bytes[..e.valid_up_to()].iter().filter(|&&b| b == b'\n').count();
        SceneError::line(file, line, "is not UTF-8 text")
    })?;
    let goes_on = text.contains("\\\n") || text.contains("\\\r\n");
    Ok(if goes_on { Cow::Owned(joined(text)) } else { Cow::Borrowed(text) })
}

/// Joins each line that ends in `\` with the next one. Empty lines keep the numbers of later lines.
fn joined(text: &str) -> String {
    let mut joined = String::with_capacity(text.len());
    let (mut owed, mut is_comment) = (0, false);
    for line in text.lines() {
        if owed == 0 {
            is_comment = line.trim_start().starts_with('#');
        }
        match line.strip_suffix('\\').filter(|_| !is_comment) {
            Some(part) => {
                joined += part;
                joined.push(' ');
                owed += 1;
            }
            None => {
                joined += line;
                joined.extend(std::iter::repeat_n('\n', owed + 1));
                owed = 0;
            }
        }
    }
    joined
}

/// Removes a comment after numbers.
pub(crate) fn without_comment(numbers: &str) -> &str {
    numbers.split_once('#').map_or(numbers, |(numbers, _)| numbers.trim_end())
}
