//! Units of time, work and money.

pub(crate) const MICROSECONDS_PER_SECOND: u128 = 1_000_000;
pub(crate) const MICROSECONDS_PER_HOUR: i128 = 3_600_000_000;

/// Work in millionths: a node of speed s does s of them in a microsecond.
pub(crate) fn in_millionths(work: u128) -> u128 {
    work.saturating_mul(MICROSECONDS_PER_SECOND)
}
