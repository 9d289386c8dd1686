//! Texts with placeholders, such as `frame-{frame:04}.png`.

use serde::{Deserialize, Deserializer, de};
use std::collections::BTreeMap;

/// Values of placeholders by name.
pub(crate) type Values = BTreeMap<String, String>;

/// A text with placeholders. `{{` and `}}` are braces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Template {
    pieces: Vec<Piece>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Piece {
    Text(String),
    /// A name, and the least number of digits. Zeros fill it up.
    Placeholder(String, usize),
}

impl Template {
    /// Reads a text. The error says what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (mut pieces, mut plain) = (Vec::new(), String::new());
        let mut rest = text;
        while let Some(at) = rest.find(['{', '}']) {
            plain.push_str(&rest[..at]);
            let brace = &rest[at..=at];
            rest = &rest[at + 1..];
            if let Some(after) = rest.strip_prefix(brace) {
                plain.push_str(brace);
                rest = after;
                continue;
            }
            if brace == "}" {
                return Err(format!("`}}` without `{{` in `{text}`; write `}}}}` for a brace"));
            }
            let Some((inside, after)) = rest.split_once('}') else {
                return Err(format!("`{{` without `}}` in `{text}`; write `{{{{` for a brace"));
            };
            if !plain.is_empty() {
                pieces.push(Piece::Text(std::mem::take(&mut plain)));
            }
            let (name, digits) = inside.split_once(':').unwrap_or((inside, "0"));
            let digits = digits.parse().ok().filter(|&digits| digits <= 20).ok_or_else(|| {
                format!("`{{{inside}}}`: after the colon comes the number of digits, such as `04`")
            })?;
            pieces.push(Piece::Placeholder(name.to_owned(), digits));
            rest = after;
        }
        plain.push_str(rest);
        if !plain.is_empty() {
            pieces.push(Piece::Text(plain));
        }
        Ok(Self { pieces })
    }

    /// A text without placeholders.
    pub fn text(text: &str) -> Self {
        Self { pieces: vec![Piece::Text(text.to_owned())] }
    }

    /// A placeholder alone.
    pub fn placeholder(name: &str) -> Self {
        Self { pieces: vec![Piece::Placeholder(name.to_owned(), 0)] }
    }

    /// Whether it begins with a text that is no absolute path.
    pub fn begins_relative(&self) -> bool {
        matches!(self.pieces.first(), Some(Piece::Text(text)) if !text.is_empty() && !text.starts_with('/'))
    }

    /// All of it, if it has no placeholder.
    pub fn fixed(&self) -> Option<String> {
        self.names().next().is_none().then(|| self.fill(&Values::new()))
    }

    /// Texts one after the other.
    pub fn joined(all: impl IntoIterator<Item = Self>) -> Self {
        Self { pieces: all.into_iter().flat_map(|one| one.pieces).collect() }
    }

    /// Names of its placeholders.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.pieces.iter().filter_map(|piece| match piece {
            Piece::Placeholder(name, _) => Some(name.as_str()),
            Piece::Text(_) => None,
        })
    }

    /// The text with values. What has no value is left out: names are checked when the file is read.
    pub fn fill(&self, values: &Values) -> String {
        let mut text = String::new();
        for piece in &self.pieces {
            match piece {
                Piece::Text(plain) => text.push_str(plain),
                Piece::Placeholder(name, digits) => {
                    let value = values.get(name).map_or("", String::as_str);
                    // Without digits, what looks like a number may be a name: `007`.
                    match value.parse::<i64>().ok().filter(|_| *digits > 0) {
                        Some(number) => text.push_str(&format!("{number:0digits$}", digits = *digits)),
                        None => text.push_str(value),
                    }
                }
            }
        }
        text
    }
}

impl<'de> Deserialize<'de> for Template {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Self::parse(&String::deserialize(from)?).map_err(de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placeholders_are_filled_and_double_braces_are_braces() {
        let values = [("frame", "7"), ("name", "a b"), ("empty", "")];
        let values = values.map(|(name, value)| (name.to_owned(), value.to_owned())).into();
        let fill = |text: &str| Template::parse(text).unwrap().fill(&values);
        assert_eq!(fill("frame-{frame:04}.png"), "frame-0007.png");
        assert_eq!(fill("{{{name}}}{empty}!"), "{a b}!");
        assert_eq!(fill("plain"), "plain");
        assert_eq!(Template::parse("{a}{b:2}").unwrap().names().collect::<Vec<_>>(), ["a", "b"]);
    }

    #[test]
    fn lone_braces_and_other_formats_are_refused() {
        for (text, reason) in [("{frame", "without `}`"), ("a}", "without `{`"), ("{frame:x}", "digits")] {
            let error = Template::parse(text).unwrap_err();
            assert!(error.contains(reason), "{error}");
        }
    }
}
