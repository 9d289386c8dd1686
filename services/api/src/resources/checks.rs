//! Checks of fields that several requests have.

use std::ops::RangeInclusive;

use forelight_protocol::{Money, ProblemKind};

use crate::error::{ApiError, ApiResult};

/// Largest accepted sum of money: 10¹² units. No sum of such amounts overflows.
pub(crate) const HIGHEST_SUM: Money = Money(1_000_000_000_000_000_000);

/// Checks a name: people must be able to read it on a screen.
pub(crate) fn check_name(pointer: &str, name: &str, longest: usize) -> ApiResult<()> {
    let length = name.chars().count();
    if !(1..=longest).contains(&length) || name.trim().is_empty() {
        return Err(ApiError::invalid(pointer, format!("a name has 1 to {longest} characters")));
    }
    if name.chars().any(char::is_control) {
        return Err(ApiError::invalid(pointer, "a name has no control characters"));
    }
    Ok(())
}

/// Checks the text of a search.
pub(crate) fn check_search(text: Option<&str>) -> ApiResult<()> {
    match text {
        Some(text) if text.chars().count() > 200 => {
            let reason = "a search has at most 200 characters";
            Err(ApiError::new(ProblemKind::Invalid, reason).in_parameter("search"))
        }
        _ => Ok(()),
    }
}

pub(crate) fn within(pointer: &str, value: i64, range: RangeInclusive<i64>) -> ApiResult<()> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(ApiError::invalid(pointer, format!("{value} is not within {} to {}", range.start(), range.end())))
}
