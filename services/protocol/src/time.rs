//! Points in time.

use std::fmt;
use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::ToSchema;

/// An instant: whole microseconds since 1970-01-01T00:00:00Z, negative before. In JSON an RFC 3339 string in
/// UTC with six fractional digits, so strings sort like instants. Requests may use any UTC offset; further
/// digits are dropped.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default, ToSchema)]
#[schema(value_type = String, format = DateTime, example = "2026-03-01T18:00:00.000000Z")]
pub struct Timestamp(i64);

/// A string that is not an RFC 3339 instant in the years 0 to 9999.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not an RFC 3339 time with an offset, such as 2026-03-01T18:00:00Z")]
pub struct MalformedTime {
    text: String,
}

/// The range of four-digit years: 0000-01-01T00:00:00Z to 9999-12-30T00:00:00Z.
const EARLIEST: i64 = -62_167_219_200_000_000;
const LATEST: i64 = 253_402_128_000_000_000;

impl Timestamp {
    /// The instant this many microseconds after the epoch, clamped to the years 0 to 9999.
    pub const fn from_micros(micros: i64) -> Self {
        Self(if micros < EARLIEST {
            EARLIEST
        } else if micros > LATEST {
            LATEST
        } else {
            micros
        })
    }

    /// Microseconds since the epoch.
    pub const fn micros(self) -> i64 {
        self.0
    }

    /// The instant `micros` microseconds later, or earlier if negative.
    pub const fn plus_micros(self, micros: i64) -> Self {
        Self::from_micros(self.0.saturating_add(micros))
    }

    /// Microseconds from `earlier` to `self`.
    pub const fn micros_since(self, earlier: Timestamp) -> i64 {
        self.0.saturating_sub(earlier.0)
    }

    /// The present instant by the system clock.
    pub fn now() -> Self {
        Self::from_micros(jiff::Timestamp::now().as_microsecond())
    }
}

impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match jiff::Timestamp::from_microsecond(self.0) {
            Ok(instant) => write!(f, "{instant:.6}"),
            Err(_) => Err(fmt::Error),
        }
    }
}

impl FromStr for Timestamp {
    type Err = MalformedTime;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let malformed =
            || MalformedTime { text: text.chars().take(64).flat_map(char::escape_debug).collect() };
        let instant: jiff::Timestamp = text.parse().map_err(|_| malformed())?;
        let micros = i64::try_from(instant.as_nanosecond().div_euclid(1000)).map_err(|_| malformed())?;
        if (EARLIEST..=LATEST).contains(&micros) { Ok(Self(micros)) } else { Err(malformed()) }
    }
}

impl Serialize for Timestamp {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Timestamp {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = std::borrow::Cow::<'de, str>::deserialize(deserializer)?;
        text.parse().map_err(D::Error::custom)
    }
}

/// A duration for people: `45 s`, `29 min 43 s`, `2 h 5 min`, without zeros at the end.
pub fn duration_in_words(seconds: i64) -> String {
    let of = |(whole, unit): (i64, &str), (part, part_unit): (i64, &str)| match part {
        0 => format!("{whole} {unit}"),
        _ => format!("{whole} {unit} {part} {part_unit}"),
    };
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, seconds) => format!("{seconds} s"),
        (0, minutes, seconds) => of((minutes, "min"), (seconds, "s")),
        (hours, minutes, _) => of((hours, "h"), (minutes, "min")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_six_digits_and_come_back_unchanged() {
        for micros in [0, 1, -1, 999_999, 1_767_225_600_000_000, EARLIEST, LATEST] {
            let time = Timestamp::from_micros(micros);
            let json = serde_json::to_string(&time).unwrap();
            assert_eq!(json.len(), "\"2026-03-01T18:00:00.000000Z\"".len(), "{json}");
            assert_eq!(serde_json::from_str::<Timestamp>(&json).unwrap(), time);
        }
        assert_eq!(Timestamp::from_micros(1).to_string(), "1970-01-01T00:00:00.000001Z");
    }

    #[test]
    fn offsets_are_understood_and_nanoseconds_go_towards_the_past() {
        let utc: Timestamp = "2026-03-01T18:00:00Z".parse().unwrap();
        assert_eq!("2026-03-01T20:00:00.000000999+02:00".parse::<Timestamp>().unwrap(), utc);
        assert_eq!("1969-12-31T23:59:59.9999999Z".parse::<Timestamp>().unwrap().micros(), -1);
    }

    #[test]
    fn text_without_an_offset_is_refused_in_one_line() {
        for text in ["", "tomorrow", "2026-03-01", "2026-03-01T18:00:00", "2026-13-01T00:00:00Z", "a\nb"] {
            let message = text.parse::<Timestamp>().unwrap_err().to_string();
            assert!(message.contains("RFC 3339") && !message.contains('\n'), "{message}");
        }
    }

    #[test]
    fn absurd_microseconds_saturate_instead_of_overflowing() {
        assert_eq!(Timestamp::from_micros(i64::MAX).plus_micros(i64::MAX).micros(), LATEST);
        assert!(Timestamp::from_micros(i64::MIN).to_string().starts_with("0000-01-01"));
    }

    #[test]
    fn durations_are_written_for_people() {
        let said = [0, 59, 60, 3_599, 3_600, 7_530].map(duration_in_words);
        assert_eq!(said, ["0 s", "59 s", "1 min", "59 min 59 s", "1 h", "2 h 5 min"]);
    }
}
