//! Paths of a job's images on shared storage.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most characters of a pattern.
const MOST: usize = 500;

/// Pattern of the paths of a job's images, below the service's output root, such as
/// `{project}/{job}/{frame:04}.exr`.
///
/// | placeholder | becomes |
/// | --- | --- |
/// | `{project}`, `{job}` | the name; characters other than letters, digits, `-`, `_`, `.` and space become `_` |
/// | `{id}` | the job's id |
/// | `{frame}`, `{frame:04}` | the frame's number, with zeros to this width |
///
/// A name that ends in `.png` gets the picture for viewing, any other the image.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(try_from = "String", into = "String")]
#[schema(value_type = String, min_length = 1, max_length = 500)]
pub struct OutputPattern(String);

/// Why a text is no pattern of paths.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{0}")]
pub struct NoPattern(String);

/// The frame that a path is of.
#[derive(Clone, Copy, Debug)]
pub struct OutputOf<'a> {
    /// Name of the project.
    pub project: &'a str,
    /// Name of the job.
    pub job: &'a str,
    /// Id of the job.
    pub id: crate::JobId,
    /// The frame.
    pub frame: u32,
}

/// A piece of a pattern.
enum Piece<'a> {
    Text(&'a str),
    Project,
    Job,
    Id,
    /// The frame's number, with zeros to this width.
    Frame(usize),
}

impl OutputPattern {
    /// The path of a frame's image, relative to the output root. Its parts are separated by `/`, and none is empty,
    /// `.` or `..`.
    pub fn path(&self, of: OutputOf<'_>) -> String {
        // The pattern was checked when it was made.
        pieces(&self.0).unwrap_or_default().iter().map(|piece| piece.of(of)).collect()
    }

    /// Whether its files are in a folder that no other project has.
    pub fn is_of_project(&self, project: &str) -> bool {
        self.0.starts_with("{project}/") && name(project) == project
    }

    /// Whether its files are the pictures for viewing.
    pub fn is_picture(&self) -> bool {
        self.0.to_ascii_lowercase().ends_with(".png")
    }
}

impl Piece<'_> {
    fn of(&self, of: OutputOf<'_>) -> String {
        match self {
            Piece::Text(text) => (*text).to_owned(),
            Piece::Project => name(of.project),
            Piece::Job => name(of.job),
            Piece::Id => of.id.to_string(),
            Piece::Frame(width) => format!("{:0width$}", of.frame),
        }
    }
}

/// A name as a part of a path: it never has a separator, and never begins with a dot.
fn name(text: &str) -> String {
    let kept = |c: char| if c.is_alphanumeric() || "-_. ".contains(c) { c } else { '_' };
    let name: String = text.chars().map(kept).collect();
    match name.trim() {
        "" => "_".to_owned(),
        trimmed if trimmed.starts_with('.') => format!("_{}", &trimmed[1..]),
        trimmed => trimmed.to_owned(),
    }
}

fn pieces(pattern: &str) -> Result<Vec<Piece<'_>>, NoPattern> {
    let mut pieces = Vec::new();
    let mut rest = pattern;
    while let Some(open) = rest.find('{') {
        pieces.push(Piece::Text(&rest[..open]));
        let inside = &rest[open + 1..];
        let close = inside.find('}').ok_or_else(|| NoPattern("a placeholder is not closed".to_owned()))?;
        pieces.push(match &inside[..close] {
            "project" => Piece::Project,
            "job" => Piece::Job,
            "id" => Piece::Id,
            "frame" => Piece::Frame(1),
            other => Piece::Frame(width(other).ok_or_else(|| {
                NoPattern(format!("{{{other}}} is no placeholder: use {{project}}, {{job}}, {{id}}, {{frame}} or {{frame:04}}"))
            })?),
        });
        rest = &inside[close + 1..];
    }
    pieces.push(Piece::Text(rest));
    Ok(pieces)
}

/// The width in `frame:04`: one or two digits after a zero.
fn width(placeholder: &str) -> Option<usize> {
    let digits = placeholder.strip_prefix("frame:0")?;
    digits.parse().ok().filter(|width| (1..=20).contains(width))
}

impl FromStr for OutputPattern {
    type Err = NoPattern;

    fn from_str(text: &str) -> Result<Self, NoPattern> {
        let no = |reason: &str| Err(NoPattern(reason.to_owned()));
        if text.is_empty() || text.chars().count() > MOST {
            return no("a pattern has 1 to 500 characters");
        }
        if text.chars().any(|c| c.is_control() || c == '\\') {
            return no("a pattern has no backslashes and no control characters");
        }
        if text.split('/').any(|part| matches!(part, "" | "." | "..")) {
            return no("a pattern is a relative path, without empty parts, . or ..");
        }
        if !pieces(text)?.iter().any(|piece| matches!(piece, Piece::Frame(_))) {
            return no("without {frame}, all frames would have one name");
        }
        if text.rsplit('/').next().is_none_or(|file| !file.contains('.')) {
            return no("the name of the file needs an ending, such as .exr");
        }
        Ok(Self(text.to_owned()))
    }
}

impl TryFrom<String> for OutputPattern {
    type Error = NoPattern;

    fn try_from(text: String) -> Result<Self, NoPattern> {
        text.parse()
    }
}

impl From<OutputPattern> for String {
    fn from(pattern: OutputPattern) -> Self {
        pattern.0
    }
}

impl fmt::Display for OutputPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::JobId;

    fn path(pattern: &str, project: &str, job: &str) -> String {
        let of = OutputOf { project, job, id: JobId(uuid::Uuid::nil()), frame: 7 };
        pattern.parse::<OutputPattern>().unwrap().path(of)
    }

    #[test]
    fn placeholders_become_names_and_numbers() {
        assert_eq!(path("{project}/{job}/{frame:04}.exr", "heron", "shot 12"), "heron/shot 12/0007.exr");
        assert_eq!(path("out/{id}.{frame}.png", "p", "j"), "out/00000000-0000-0000-0000-000000000000.7.png");
    }

    #[test]
    fn no_name_leads_out_of_its_folder() {
        for name in ["..", "../../etc", "/etc", ".", "", " ", "a\0b", "..\\x", "…/..", ".hidden"] {
            let made = path("{project}/{job}/{frame}.exr", name, name);
            assert_eq!(made.split('/').count(), 3, "{made:?}");
            assert!(made.split('/').all(|part| !part.is_empty() && !part.starts_with('.')), "{made:?}");
            assert!(!made.contains(['\0', '\\']), "{made:?}");
        }
    }

    #[test]
    fn what_is_no_pattern_is_refused_with_the_reason() {
        for (text, reason) in [
            ("", "1 to 500"),
            ("/abs/{frame}.exr", "relative"),
            ("a/../{frame}.exr", "relative"),
            ("a//{frame}.exr", "relative"),
            ("./{frame}.exr", "relative"),
            ("a\\{frame}.exr", "backslashes"),
            ("{job}.exr", "without {frame}"),
            ("{frame}", "ending"),
            ("{shot}/{frame}.exr", "{shot} is no placeholder"),
            ("{frame:4}.exr", "{frame:4} is no placeholder"),
            ("{frame:099}.exr", "no placeholder"),
            ("{frame.exr", "not closed"),
        ] {
            let error = text.parse::<OutputPattern>().unwrap_err().to_string();
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
