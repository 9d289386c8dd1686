//! Names, durations and amounts.

use std::collections::BTreeMap;

use jiff::{SignedDuration, Span, SpanRelativeTo};

use super::error::DescriptionError;

const MICRO: f64 = 1e6;

/// Index by name.
pub(super) fn names<'n>(
    what: &'static str,
    all: impl Iterator<Item = &'n String>,
) -> Result<BTreeMap<String, u64>, DescriptionError> {
    let mut places = BTreeMap::new();
    for (name, place) in all.zip(0..) {
        if places.insert(name.clone(), place).is_some() {
            return Err(DescriptionError::Twice { what, name: name.clone() });
        }
    }
    Ok(places)
}

pub(super) fn known(
    places: &BTreeMap<String, u64>,
    what: &'static str,
    name: &str,
    at: &str,
) -> Result<u64, DescriptionError> {
    let unknown = || DescriptionError::Unknown { at: at.to_owned(), what, name: name.to_owned() };
    places.get(name).copied().ok_or_else(unknown)
}

/// A duration such as `90m`, `1h30m` or `7d`. A day has 24 hours.
pub(super) fn duration(text: &str, at: &str) -> Result<i64, DescriptionError> {
    let wrong = || DescriptionError::Value {
        at: at.to_owned(),
        reason: format!("{text:?} is not a duration: write one such as 90m, 1h30m or 7d"),
    };
    let span: Span = text.parse().map_err(|_| wrong())?;
    let length: SignedDuration =
        span.to_duration(SpanRelativeTo::days_are_24_hours()).map_err(|_| wrong())?;
    let micros = i64::try_from(length.as_micros()).map_err(|_| wrong())?;
    if micros < 0 { Err(wrong()) } else { Ok(micros) }
}

/// A non-negative value, converted to smaller units.
pub(super) fn scaled(value: f64, units: f64, at: &str, field: &str) -> Result<u64, DescriptionError> {
    let product = (value * units).round();
    if product.is_finite() && (0.0..1.8e19).contains(&product) {
        return Ok(product as u64);
    }
    Err(DescriptionError::Value {
        at: format!("{at}, {field}"),
        reason: format!("{value} is negative or too large"),
    })
}

pub(super) fn money(value: f64, at: &str, field: &str) -> Result<i64, DescriptionError> {
    let amount = scaled(value, MICRO, at, field)?;
    i64::try_from(amount).map_err(|_| DescriptionError::Value {
        at: format!("{at}, {field}"),
        reason: format!("{value} is too large"),
    })
}
