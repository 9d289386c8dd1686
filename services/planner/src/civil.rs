//! Expands weekly calendars, such as "weekdays from 20:00 to 08:00 in Berlin", to instants.
//!
//! The caller looks up the time zone, so the planner reads no time zone database.

use jiff::civil::{Date, Time, Weekday};
use jiff::tz::TimeZone;
use jiff::{Timestamp, ToSpan};

use crate::intervals::Intervals;
use crate::model::Interval;

/// A weekly window, in wall-clock times.
///
/// A time that clocks skip is moved later by the skipped span. Of a time that occurs twice, the first is used
/// (RFC 5545, 3.3.5).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Weekly {
    /// The time zone of the clock.
    pub zone: TimeZone,
    /// Days on which the window opens. Empty: every day.
    pub days: Vec<Weekday>,
    /// Time at which the window opens.
    pub from: Time,
    /// Time at which the window closes. It is on the next day if it is not after `from`; equal times are a
    /// whole day.
    pub until: Time,
}

/// Why a calendar cannot be expanded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CalendarError {
    /// An instant is outside of the calendar's range of years.
    #[error("instant {0} (microseconds UTC) is outside the calendar's range of years")]
    Range(i64),
    /// The range to expand is too long.
    #[error("a calendar can be expanded over at most 100 years")]
    TooLong,
}

const HUNDRED_YEARS: i64 = 100 * 366 * 86_400_000_000;

/// Returns when some window is open between two instants. Sorted; intervals that overlap or touch are joined.
///
/// # Errors
/// If the instants are out of range or too far apart.
pub fn expand(windows: &[Weekly], from: i64, until: i64) -> Result<Vec<Interval>, CalendarError> {
    if until.saturating_sub(from) > HUNDRED_YEARS {
        return Err(CalendarError::TooLong);
    }
    let mut open = Vec::new();
    for Weekly { zone, days, from: opens, until: closes } in windows {
        let instant = |date: Date, time: Time| match date.to_datetime(time).to_zoned(zone.clone()) {
            Ok(zoned) => Ok(zoned.timestamp().as_microsecond()),
            Err(_) => Err(CalendarError::Range(until)),
        };
        let day_of = |instant: i64| match Timestamp::from_microsecond(instant) {
            Ok(at) => Ok(zone.to_datetime(at).date()),
            Err(_) => Err(CalendarError::Range(instant)),
        };
        let last = day_of(until)?;
        // A window of the day before may still be open.
        let first = day_of(from)?.saturating_sub(1.day());
        for day in first.series(1.day()).take_while(|&day| day <= last && from < until) {
            if !days.is_empty() && !days.contains(&day.weekday()) {
                continue;
            }
            let next = if closes > opens { day } else { day.saturating_add(1.day()) };
            let (start, end) = (instant(day, *opens)?, instant(next, *closes)?);
            open.push((start.max(from), end.min(until)));
        }
    }
    Ok(Intervals::union(open).iter().map(|(start, end)| Interval { start, end: Some(end) }).collect())
}

#[cfg(test)]
mod tests {
    use super::{CalendarError, Weekly, expand};
    use jiff::civil::{Weekday, time};
    use jiff::tz::TimeZone;

    const HOUR: i64 = 3_600_000_000;

    fn at(text: &str) -> i64 {
        text.parse::<jiff::Timestamp>().expect("an instant").as_microsecond()
    }

    fn nightly(zone: &str, from: i8, until: i8) -> Weekly {
        Weekly {
            zone: TimeZone::get(zone).expect("a time zone"),
            days: Vec::new(),
            from: time(from, 0, 0, 0),
            until: time(until, 0, 0, 0),
        }
    }

    fn lengths(window: &Weekly, from: &str, until: &str) -> Vec<i64> {
        let open = expand(std::slice::from_ref(window), at(from), at(until)).expect("a calendar");
        open.iter().map(|interval| (interval.end.expect("an end") - interval.start) / HOUR).collect()
    }

    #[test]
    fn a_night_is_an_hour_shorter_in_spring_and_longer_in_autumn() {
        let night = nightly("Europe/Berlin", 20, 8);
        assert_eq!(lengths(&night, "2026-03-27T12:00:00Z", "2026-03-30T12:00:00Z"), [12, 11, 12]);
        assert_eq!(lengths(&night, "2026-10-23T12:00:00Z", "2026-10-26T12:00:00Z"), [12, 13, 12]);
    }

    #[test]
    fn times_that_do_not_exist_are_later_and_those_that_are_there_twice_are_the_first() {
        let two =
            Weekly { from: time(2, 30, 0, 0), until: time(3, 30, 0, 0), ..nightly("Europe/Berlin", 0, 0) };
        let open = |from, until| expand(std::slice::from_ref(&two), at(from), at(until)).expect("a calendar");
        // Clocks skip from 02:00 to 03:00, so nothing is left of the window.
        assert_eq!(open("2026-03-29T00:00:00Z", "2026-03-29T12:00:00Z"), []);
        let autumn = open("2026-10-25T00:00:00Z", "2026-10-25T12:00:00Z");
        assert_eq!(autumn[0].start, at("2026-10-25T00:30:00Z"));
        assert_eq!(autumn[0].end, Some(at("2026-10-25T02:30:00Z")));
    }

    #[test]
    fn whole_days_touch_and_become_one_whatever_the_clock_does() {
        let always = nightly("America/Sao_Paulo", 0, 0);
        assert_eq!(lengths(&always, "2018-10-01T03:00:00Z", "2018-12-01T02:00:00Z").len(), 1);
        assert_eq!(
            lengths(&nightly("Pacific/Apia", 0, 0), "2011-12-28T00:00:00Z", "2012-01-02T00:00:00Z").len(),
            1
        );
    }

    #[test]
    fn windows_are_cut_at_the_ends_and_empty_ranges_have_none() {
        let night = nightly("UTC", 20, 8);
        let weekend = Weekly { days: vec![Weekday::Saturday], ..night.clone() };
        assert_eq!(lengths(&night, "2026-01-01T07:00:00Z", "2026-01-01T22:00:00Z"), [1, 2]);
        assert_eq!(lengths(&weekend, "2026-01-01T00:00:00Z", "2026-01-08T00:00:00Z"), [12]);
        assert!(lengths(&night, "2026-01-01T22:00:00Z", "2026-01-01T22:00:00Z").is_empty());
    }

    #[test]
    fn instants_beyond_all_calendars_and_endless_ranges_are_refused() {
        let night = nightly("UTC", 0, 8);
        assert_eq!(expand(&[night], i64::MAX - HOUR, i64::MAX), Err(CalendarError::Range(i64::MAX)));
        assert_eq!(expand(&[], 0, i64::MAX), Err(CalendarError::TooLong));
    }
}
