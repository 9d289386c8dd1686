//! JSON documents in files that the user names.

use crate::atomic_file::write_bytes;
use crate::bounded_file;
use crate::failure::BadInput;
use crate::output::pretty;
use anyhow::Result;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::error::Category;
use std::path::Path;

/// Largest size of a document, bytes.
const MOST: u64 = 1 << 28;

/// Reads a document.
///
/// # Errors
/// Names the file, the field and the reason.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T> {
    parse(path, |wrong| wrong)
}

/// Like [`read`], for a document that `command` writes. An error names the command.
pub fn read_written_by<T: DeserializeOwned>(command: &str, path: &Path) -> Result<T> {
    parse(path, |wrong| wrong.hint(format!("this file must be written by `{command}`")))
}

/// Writes a document if `path` is set.
pub fn write(path: Option<&Path>, document: &impl Serialize) -> Result<()> {
    path.map_or(Ok(()), |path| write_bytes(path, (pretty(document)? + "\n").as_bytes()))
}

fn parse<T: DeserializeOwned>(path: &Path, hinted: impl Fn(BadInput) -> BadInput) -> Result<T> {
    let wrong = |why: String| hinted(BadInput::new(format!("{}: {why}", path.display())));
    let text = bounded_file::read(path, MOST)?;
    let mut reader = serde_json::Deserializer::from_slice(&text);
    let document = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        // Text that is not JSON has no field.
        let is_whole = error.path().iter().next().is_none();
        let place = if is_whole { String::new() } else { format!("{}: ", error.path()) };
        wrong(format!("{place}{}", reason(error.inner())))
    })?;
    reader.end().map_err(|error| wrong(reason(&error)))?;
    Ok(document)
}

/// What is wrong with a text, or with what it says.
fn reason(error: &serde_json::Error) -> String {
    match error.classify() {
        Category::Syntax | Category::Eof => format!("this is not a JSON document: {error}"),
        Category::Data | Category::Io => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::RenderSettingsRequest;
    use std::fs;

    #[test]
    fn what_is_wrong_is_said_with_file_and_field() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.json");
        let message = || read::<RenderSettingsRequest>(&path).unwrap_err().to_string();
        assert!(message().contains("x.json: No such file"), "{}", message());
        for (text, reason) in [
            (r#"{"spp": "many"}"#, "x.json: spp: invalid type"),
            (r#"{"spp": 4} {}"#, "x.json: this is not a JSON document: trailing characters"),
            ("spp: 4", "x.json: this is not a JSON document: expected value at line 1"),
            (r#"{"spp": 4"#, "EOF"),
        ] {
            fs::write(&path, text).unwrap();
            assert!(message().contains(reason), "{text}: {}", message());
        }
        let other = read_written_by::<RenderSettingsRequest>("forelight x --out", &path).unwrap_err();
        let other = other.downcast_ref::<BadInput>().unwrap();
        assert!(format!("{other:?}").contains("written by `forelight x --out`"), "{other:?}");
        fs::write(&path, r#"{"spp": 4}"#).unwrap();
        assert_eq!(read::<RenderSettingsRequest>(&path).unwrap().spp, Some(4));
    }
}
