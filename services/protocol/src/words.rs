//! Counted things in words.

use serde::de::{DeserializeOwned, IntoDeserializer as _};
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

/// The value of an enumeration with this JSON name.
///
/// # Errors
/// Says which names there are.
pub fn by_name<T: DeserializeOwned>(name: &str) -> Result<T, String> {
    T::deserialize(name.into_deserializer()).map_err(|error: serde::de::value::Error| {
        let error = error.to_string();
        // Serde says the wrong name first, which the caller knows.
        error.rfind("expected ").map_or(error.clone(), |at| error[at..].replace('`', ""))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Role;

    #[test]
    fn a_name_that_is_none_is_answered_with_all_names() {
        assert_eq!(by_name("worker"), Ok(Role::Worker));
        let error = by_name::<Role>("boss, expected `x`").unwrap_err();
        assert_eq!(error, format!("expected one of {}", Role::ALL.map(Role::name).join(", ")));
    }

    #[test]
    fn one_thing_has_no_s() {
        assert_eq!([0u32, 1, 2].map(|frames| counted(frames, "frame")), ["0 frames", "1 frame", "2 frames"]);
        assert_eq!([0u32, 1, 2].map(is_or_are), ["are", "is", "are"]);
        assert_eq!([0u32, 1, 2].map(was_or_were), ["were", "was", "were"]);
    }
}
