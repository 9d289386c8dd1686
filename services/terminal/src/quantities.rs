//! Durations, instants and amounts of money as people type and read them.
//!
//! Time is integer microseconds UTC, and money integer micro-units. No amount passes through a float before a
//! comparison.

use jiff::civil::{DateTime, Time};
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Span, SpanRelativeTo, Timestamp, ToSpan as _, Unit};
use regex::Regex;
use std::sync::LazyLock;

/// Micro-units in one unit of the farm's currency.
pub const MICRO_UNITS: i64 = 1_000_000;

/// A job's deadline, as typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deadline {
    /// This long after the submission.
    In(SignedDuration),
    /// At this instant.
    At(Timestamp),
    /// When clocks here show this time next.
    Next(Time),
    /// When clocks here show this time tomorrow.
    Tomorrow(Time),
}

impl Deadline {
    /// The instant, if it is now `now`.
    pub fn instant(self, now: Timestamp) -> Result<Timestamp, String> {
        match self {
            Self::At(instant) => Ok(instant),
            Self::Next(time) => on_the_clock(time, now, 0)
                .filter(|&instant| instant > now)
                .or_else(|| on_the_clock(time, now, 1))
                .ok_or_else(|| "the deadline is beyond the calendar".into()),
            Self::Tomorrow(time) => {
                on_the_clock(time, now, 1).ok_or_else(|| "the deadline is beyond the calendar".into())
            }
            Self::In(duration) => {
                now.checked_add(duration).map_err(|_| "the deadline is beyond the calendar".into())
            }
        }
    }
}

/// A time of day, and a date with one.
static TIME: LazyLock<Regex> = LazyLock::new(|| pattern(r"^\d\d:\d\d(:\d\d)?$"));
static DATE_AND_TIME: LazyLock<Regex> = LazyLock::new(|| pattern(r"^\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d)?$"));

/// Compiles a pattern of this file.
fn pattern(text: &str) -> Regex {
    Regex::new(text).expect("it is a regular expression")
}

/// The instant at which clocks here show a date and a time.
fn local_instant(text: &str) -> Option<Timestamp> {
    let local: DateTime = text.parse().ok()?;
    Some(local.to_zoned(TimeZone::system()).ok()?.timestamp())
}

/// The instant at which clocks here show a time, so many days after today.
fn on_the_clock(time: Time, now: Timestamp, days: i64) -> Option<Timestamp> {
    let day = now.to_zoned(TimeZone::system()).checked_add(days.days()).ok()?;
    day.with().time(time).build().ok().map(|zoned| zoned.timestamp())
}

/// Reads `2h`, `45m`, `1h30m`, `2d`, a time of day such as `06:00` or `tomorrow 06:00`, or an RFC 3339 instant such
/// as `2030-03-01T06:00:00Z`.
pub fn parse_deadline(text: &str) -> Result<Deadline, String> {
    if let Ok(instant) = text.parse::<Timestamp>() {
        return Ok(Deadline::At(instant));
    }
    // Without an offset, it is a time here.
    if let Some(instant) = DATE_AND_TIME.is_match(text).then(|| local_instant(text)).flatten() {
        return Ok(Deadline::At(instant));
    }
    let time = |text: &str| TIME.is_match(text).then(|| text.parse().ok()).flatten();
    if let Some(time) = time(text) {
        return Ok(Deadline::Next(time));
    }
    if let Some(time) = text.strip_prefix("tomorrow ").and_then(time) {
        return Ok(Deadline::Tomorrow(time));
    }
    match parse_duration(text) {
        // 6:00:00 would be six hours.
        Ok(duration) if !text.contains(':') => Ok(Deadline::In(duration)),
        Err(_) if text.starts_with('-') && text[1..].starts_with(|c: char| c.is_ascii_digit()) => {
            Err("it must be in the future, such as 45m, 2h or 06:00".into())
        }
        _ => {
            Err("expected a duration such as 2h, 45m or 1h30m, a time such as 06:00 or `tomorrow 06:00`, or \
            an instant such as 2030-03-01T06:00:00Z"
                .into())
        }
    }
}

/// Reads a positive duration such as `30s`, `45m`, `2h`, `1d12h`. A day is 24 hours.
pub fn parse_duration(text: &str) -> Result<SignedDuration, String> {
    let wrong = || "expected a duration such as 30s, 45m, 2h or 1h30m".to_string();
    let span: Span = text.trim().parse().map_err(|_| wrong())?;
    let duration = span.to_duration(SpanRelativeTo::days_are_24_hours()).map_err(|_| wrong())?;
    if duration.is_zero() || duration.is_negative() {
        return Err("must be longer than 0".into());
    }
    Ok(duration)
}

/// Reads seconds from `2.5`, `90s` or `1h30m`, at most a billion.
pub fn parse_seconds(text: &str) -> Result<f64, String> {
    const MOST: f64 = 1e9;
    let seconds =
        text.trim().parse().or_else(|_| parse_duration(text).map(|duration| duration.as_secs_f64()));
    match seconds {
        Ok(seconds) if seconds > 0.0 && seconds <= MOST => Ok(seconds),
        Ok(_) => Err("must be greater than 0 and at most a billion seconds".into()),
        Err(_) => Err("expected seconds such as 2.5, or a duration such as 90s, 45m or 1h30m".into()),
    }
}

/// Reads a size such as `512MiB`, `8GiB` or `1.5GiB`, at least a mebibyte, as bytes.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let wrong = || "expected a size such as 512MiB or 8GiB, at least 1MiB".to_string();
    let text = text.trim();
    let (number, unit) = ["KiB", "MiB", "GiB", "TiB"]
        .into_iter()
        .zip([10, 20, 30, 40])
        .find_map(|(unit, power)| Some((text.strip_suffix(unit)?, 1u64 << power)))
        .unwrap_or((text, 1));
    let number: f64 = number.trim().parse().map_err(|_| wrong())?;
    let bytes = number * unit as f64;
    // No machine has a pebibyte.
    if (f64::from(1 << 20)..=1e15).contains(&bytes) { Ok(bytes.round() as u64) } else { Err(wrong()) }
}

/// Reads a non-negative decimal amount such as `12.50` as micro-units, exactly.
pub fn parse_money(text: &str) -> Result<i64, String> {
    let wrong = || "expected an amount such as 12.50, with at most six decimals".to_string();
    let (whole, fraction) = text.trim().split_once('.').unwrap_or((text.trim(), ""));
    let digits = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if whole.is_empty()
        || !digits(whole)
        || !digits(fraction)
        || fraction.len() > 6
        || text.trim().ends_with('.')
    {
        return Err(wrong());
    }
    let whole: i64 = whole.parse().map_err(|_| "the amount is too large".to_string())?;
    // Padded to six digits, the decimals are micro-units.
    let fraction: i64 = format!("{fraction:0<6}").parse().map_err(|_| wrong())?;
    whole
        .checked_mul(MICRO_UNITS)
        .and_then(|micro| micro.checked_add(fraction))
        .ok_or_else(|| "the amount is too large".to_string())
}

/// Formats micro-units as `12.50` or `0.001234`.
pub fn money(micro_units: i64) -> String {
    forelight_protocol::Money(micro_units).to_string()
}

/// Formats seconds as `0.42 s`, `12.3 s`, `3 min 7 s` or `2 h 5 min`.
pub fn seconds(seconds: f64) -> String {
    if !seconds.is_finite() {
        return "-".into();
    }
    let whole = seconds.round() as i64;
    match whole {
        _ if seconds < 10.0 => format!("{seconds:.2} s"),
        ..=99 => format!("{seconds:.1} s"),
        _ => forelight_protocol::duration_in_words(whole),
    }
}

/// Formats a count with a prefix and three significant digits: `987`, `12.3 k`, `4.56 M`.
pub fn count(value: f64) -> String {
    if !value.is_finite() {
        return "-".into();
    }
    let mut scaled = value;
    let mut prefixes = ["", " k", " M", " G", " T", " P"].iter();
    let mut prefix = prefixes.next().copied().unwrap_or_default();
    while scaled.abs() >= 999.5 {
        let Some(next) = prefixes.next() else { break };
        scaled /= 1_000.0;
        prefix = next;
    }
    match scaled.abs() {
        _ if prefix.is_empty() => format!("{scaled:.0}"),
        s if s < 9.995 => format!("{scaled:.2}{prefix}"),
        s if s < 99.95 => format!("{scaled:.1}{prefix}"),
        _ => format!("{scaled:.0}{prefix}"),
    }
}

/// Formats a size: `987 B`, `12.3 MiB`.
pub fn bytes(size: u64) -> String {
    let unit = [("TiB", 40), ("GiB", 30), ("MiB", 20), ("KiB", 10)];
    match unit.into_iter().find(|(_, power)| size >> power > 0) {
        Some((name, power)) => format!("{:.1} {name}", size as f64 / (1u64 << power) as f64),
        None => format!("{size} B"),
    }
}

/// Formats a time of today, or a date and time, in the local time zone, to the second.
pub fn clock(at: forelight_protocol::Timestamp, now: forelight_protocol::Timestamp) -> String {
    let instant =
        |at: forelight_protocol::Timestamp| Timestamp::from_microsecond(at.micros()).unwrap_or_default();
    let zone = jiff::tz::TimeZone::system();
    let (local, today) = (instant(at).to_zoned(zone.clone()), instant(now).to_zoned(zone));
    let local = local.round(Unit::Second).unwrap_or(local);
    if local.date() == today.date() {
        local.strftime("%H:%M:%S").to_string()
    } else {
        local.strftime("%d %b %H:%M:%S").to_string()
    }
}

/// Text of the service with its instants as clocks here show them.
pub fn with_local_times(text: &str, now: forelight_protocol::Timestamp) -> String {
    static INSTANT: LazyLock<Regex> = LazyLock::new(|| pattern(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z"));
    let local = |found: &regex::Captures<'_>| {
        found[0].parse().map_or_else(|_| found[0].to_owned(), |instant| clock(instant, now))
    };
    INSTANT.replace_all(text, local).into_owned()
}

/// A probability, rounded. One that is not certain is never 0 or 100 %.
pub fn probability_in_words(probability: f64) -> String {
    match (probability * 100.0).round() as u32 {
        0 if probability > 0.0 => "< 1 %".to_owned(),
        100 if probability < 1.0 => "> 99 %".to_owned(),
        rounded => format!("{rounded} %"),
    }
}

/// Formats a signed percentage with one decimal: `+3.2 %`.
pub fn percent(fraction: f64) -> String {
    if fraction.is_finite() { format!("{:+.1} %", fraction * 100.0) } else { "-".into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_of_day_is_its_next_one_and_tomorrow_is_the_day_after() {
        let zone = TimeZone::system();
        let noon =
            jiff::civil::date(2026, 11, 29).at(12, 0, 0, 0).to_zoned(zone.clone()).unwrap().timestamp();
        let at = |text: &str| {
            let instant = parse_deadline(text).unwrap().instant(noon).unwrap();
            instant.to_zoned(zone.clone()).strftime("%d %H:%M:%S").to_string()
        };
        assert_eq!(at("18:00"), "29 18:00:00");
        assert_eq!(at("06:00"), "30 06:00:00");
        assert_eq!(at("12:00"), "30 12:00:00", "that is now");
        assert_eq!(at("tomorrow 18:30:15"), "30 18:30:15");
        assert_eq!(at("2026-12-05 06:00"), "05 06:00:00");
        assert_eq!(at("2026-12-05T06:00:30"), "05 06:00:30");
        for wrong in ["06:00+02:00", "6:00", "06:00:00.5", "tomorrow 2027-01-01T06:00", "--json"] {
            assert!(parse_deadline(wrong).unwrap_err().contains("expected"), "{wrong}");
        }
        assert!(parse_deadline("-2h").unwrap_err().contains("in the future"));
    }

    #[test]
    fn instants_in_a_text_are_shown_as_local_times() {
        let now: forelight_protocol::Timestamp = "2026-11-29T12:00:00Z".parse().unwrap();
        let shown = |at: &str| clock(at.parse().unwrap(), now);
        let text =
            "expected at 2026-11-29T17:01:38.381347Z, booked is 2026-12-01T17:01:41Z; 2026-11-29 stays";
        let expected = format!(
            "expected at {}, booked is {}; 2026-11-29 stays",
            shown("2026-11-29T17:01:38.381347Z"),
            shown("2026-12-01T17:01:41Z")
        );
        assert_eq!(with_local_times(text, now), expected);
    }

    #[test]
    fn sizes_have_units_and_are_neither_nothing_nor_beyond_measure() {
        for (text, bytes) in
            [("1MiB", 1 << 20), ("1.5GiB", 3 << 29), (" 2097152 ", 2 << 20), ("8 GiB", 8 << 30)]
        {
            assert_eq!(parse_bytes(text), Ok(bytes), "{text}");
        }
        for text in ["", "1KiB", "-8GiB", "much", "NaN", "1e30", "inf", "5GB"] {
            assert!(parse_bytes(text).is_err(), "{text}");
        }
    }

    #[test]
    fn times_are_seconds_or_durations() {
        assert_eq!(["2.5", "90s", "1h30m"].map(parse_seconds), [Ok(2.5), Ok(90.0), Ok(5400.0)]);
        for wrong in ["0", "-3", "soon", "1e99", "inf", "NaN", ""] {
            assert!(parse_seconds(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn deadlines_are_durations_or_instants() {
        let now: Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
        let at = |text: &str| parse_deadline(text).unwrap().instant(now).unwrap().to_string();
        assert_eq!(at("2h"), "2026-01-01T02:00:00Z");
        assert_eq!(at("45m"), "2026-01-01T00:45:00Z");
        assert_eq!(at("1h30m"), "2026-01-01T01:30:00Z");
        assert_eq!(at("2d"), "2026-01-03T00:00:00Z");
        assert_eq!(at("2026-03-01T06:00:00+02:00"), "2026-03-01T04:00:00Z");
    }

    #[test]
    fn a_deadline_that_is_neither_is_refused_with_an_example() {
        for text in ["", "soon", "12", "-2h", "0s", "2026-03-01", "25:00", "tomorrow", "yesterday 06:00"] {
            let message = parse_deadline(text).unwrap_err();
            assert!(message.contains("45m"), "{text}: {message}");
        }
    }

    #[test]
    fn money_is_read_exactly() {
        assert_eq!(parse_money("12.50"), Ok(12_500_000));
        assert_eq!(parse_money("0.000001"), Ok(1));
        assert_eq!(parse_money("7"), Ok(7_000_000));
        for text in ["", "-1", "1.", ".5", "1.0000001", "1e3", "1,50", "99999999999999999999"] {
            assert!(parse_money(text).is_err(), "{text}");
        }
    }

    #[test]
    fn money_is_shown_to_the_cent_and_never_as_nothing_if_it_is_something() {
        assert_eq!(money(12_500_000), "12.50");
        assert_eq!(money(4_999), "0.004999");
    }

    #[test]
    fn numbers_keep_three_digits_across_every_border() {
        assert_eq!(count(999.0), "999");
        assert_eq!(count(999.6), "1.00 k");
        assert_eq!(count(12_345.0), "12.3 k");
        assert_eq!(count(999_600.0), "1.00 M");
        assert_eq!(seconds(9.994), "9.99 s");
        assert_eq!(seconds(61.0), "61.0 s");
        assert_eq!(seconds(187.0), "3 min 7 s");
        assert_eq!(seconds(7_500.0), "2 h 5 min");
        assert_eq!([3_599.4, 3_599.6].map(seconds), ["59 min 59 s", "1 h"]);
        assert_eq!(percent(0.032), "+3.2 %");
        assert_eq!(percent(f64::NAN), "-");
    }
}
