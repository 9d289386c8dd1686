//! Counted things in words.

use std::fmt::Display;

/// A number with its noun: `1 frame`, `2 frames`. The noun is given as one thing.
pub fn counted<N: Display + PartialEq + From<u8>>(number: N, noun: &str) -> String {
    let plural = if number == N::from(1) { "" } else { "s" };
    format!("{number} {noun}{plural}")
}

/// The verb of so many things.
pub fn is_or_are<N: PartialEq + From<u8>>(number: N) -> &'static str {
    if number == N::from(1) { "is" } else { "are" }
}

/// The verb of so many things in the past.
pub fn was_or_were<N: PartialEq + From<u8>>(number: N) -> &'static str {
    if number == N::from(1) { "was" } else { "were" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_thing_has_no_s() {
        assert_eq!([0u32, 1, 2].map(|frames| counted(frames, "frame")), ["0 frames", "1 frame", "2 frames"]);
        assert_eq!([0u32, 1, 2].map(is_or_are), ["are", "is", "are"]);
        assert_eq!([0u32, 1, 2].map(was_or_were), ["were", "was", "were"]);
    }
}
