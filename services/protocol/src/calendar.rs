//! When a node is available: weekly windows by the wall clock, and maintenance.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use jiff::civil::{Time, Weekday};
use jiff::tz::TimeZone;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::ToSchema;
use utoipa::openapi::{Array, Object, Type};

use crate::Timestamp;

/// Most windows of a calendar.
pub const MOST_WINDOWS: usize = 50;

/// The days in JSON, Monday first.
const DAYS: [&str; 7] = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];

fn day_name(day: Weekday) -> &'static str {
    DAYS[day.to_monday_zero_offset() as usize]
}

fn day_named(name: &str) -> Option<Weekday> {
    let place = DAYS.iter().position(|day| *day == name)?;
    Weekday::from_monday_zero_offset(place as i8).ok()
}

/// A day in JSON.
struct JsonDay(Weekday);

impl Serialize for JsonDay {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(day_name(self.0))
    }
}

impl<'de> Deserialize<'de> for JsonDay {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = Cow::<'de, str>::deserialize(deserializer)?;
        day_named(&name).map(Self).ok_or_else(|| D::Error::unknown_variant(&name, &DAYS))
    }
}

/// Lists of days in JSON.
mod json_days {
    use super::*;

    pub fn serialize<S: Serializer>(days: &[Weekday], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(days.iter().map(|&day| JsonDay(day)))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Weekday>, D::Error> {
        Ok(Vec::<JsonDay>::deserialize(deserializer)?.into_iter().map(|day| day.0).collect())
    }

    pub fn schema() -> Array {
        let day = Object::builder().schema_type(Type::String).enum_values(Some(DAYS));
        Array::builder()
            .items(day)
            .max_items(Some(7))
            .description(Some("Days on which the window opens. Empty: every day."))
            .build()
    }
}

/// `20:00`.
fn clock(time: Time) -> String {
    time.strftime("%H:%M").to_string()
}

fn parse_clock(text: &str) -> Result<Time, MalformedCalendar> {
    // The parser also takes hours of one digit.
    let time = Time::strptime("%H:%M", text).ok().filter(|&time| clock(time) == text);
    time.ok_or_else(|| MalformedCalendar::new(text, "is not a time of day, such as 20:00"))
}

/// Times of the wall clock in JSON, to the minute.
mod json_clock {
    use super::*;

    pub fn serialize<S: Serializer>(time: &Time, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&clock(*time))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Time, D::Error> {
        parse_clock(&Cow::<'de, str>::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

/// A weekly window.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeWindow {
    /// Days on which the window opens. Empty: every day.
    #[serde(default, skip_serializing_if = "Vec::is_empty", with = "json_days")]
    #[schema(schema_with = json_days::schema)]
    pub days: Vec<Weekday>,
    /// Time at which the window opens, to the minute.
    #[serde(with = "json_clock")]
    #[schema(value_type = String, pattern = "^([01][0-9]|2[0-3]):[0-5][0-9]$", example = "20:00")]
    pub from: Time,
    /// Time at which the window closes: on the next day if it is not after `from`. Equal times are a whole day.
    #[serde(with = "json_clock")]
    #[schema(value_type = String, pattern = "^([01][0-9]|2[0-3]):[0-5][0-9]$", example = "08:00")]
    pub until: Time,
}

/// When a node is awake. Times are wall-clock times of the time zone, with daylight saving.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeCalendar {
    /// Time zone, by its name in the IANA database.
    #[serde(default = "utc")]
    #[schema(default = "UTC", max_length = 100)]
    pub zone: String,
    /// The windows, 1 to 50. The node sleeps outside of them.
    #[schema(min_items = 1, max_items = 50)]
    pub windows: Vec<NodeWindow>,
}

fn utc() -> String {
    "UTC".to_owned()
}

impl NodeCalendar {
    /// Checks that numbers are in range and the time zone is known.
    ///
    /// # Errors
    /// The field and the reason.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        if !(1..=MOST_WINDOWS).contains(&self.windows.len()) {
            return Err(("windows", format!("a calendar has 1 to {MOST_WINDOWS} windows")));
        }
        if let Some(window) = self.windows.iter().find(|window| window.days.len() > 7) {
            return Err(("windows", format!("a week has 7 days, not {}", window.days.len())));
        }
        if self.zone.len() > 100 || TimeZone::get(&self.zone).is_err() {
            return Err(("zone", "unknown time zone; write for example Europe/Berlin".to_owned()));
        }
        Ok(())
    }
}

/// Text that is not a calendar.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` {reason}")]
pub struct MalformedCalendar {
    text: String,
    reason: String,
}

impl MalformedCalendar {
    fn new(text: &str, reason: impl Into<String>) -> Self {
        let text = text.chars().take(64).flat_map(char::escape_debug).collect();
        Self { text, reason: reason.into() }
    }
}

/// Parses calendars such as `Mon-Fri 20:00-08:00, Sat-Sun 00:00-00:00 Europe/Berlin`.
///
/// Commas separate windows. A window without days opens every day. The time zone is UTC unless one is given.
/// `always` is every hour of every day.
impl FromStr for NodeCalendar {
    type Err = MalformedCalendar;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const SHAPE: &str =
            "is not a calendar, such as `Mon-Fri 20:00-08:00, Sat-Sun 00:00-00:00 Europe/Berlin`";
        let malformed = || MalformedCalendar::new(text, SHAPE);
        if text.trim() == "always" {
            let window = NodeWindow { days: Vec::new(), from: Time::midnight(), until: Time::midnight() };
            return Ok(Self { zone: utc(), windows: vec![window] });
        }
        let mut zone = utc();
        let mut windows = Vec::new();
        let parts: Vec<&str> = text.split(',').collect();
        for (index, part) in parts.iter().enumerate() {
            let mut words: Vec<&str> = part.split_whitespace().collect();
            if index + 1 == parts.len() && words.last().is_some_and(|word| !word.contains(':')) {
                zone = words.pop().unwrap_or_default().to_owned();
            }
            let (days, times) = match words[..] {
                [times] => (Vec::new(), times),
                [days, times] => (days_of(days).ok_or_else(malformed)?, times),
                _ => return Err(malformed()),
            };
            let (from, until) = times.split_once('-').ok_or_else(malformed)?;
            windows.push(NodeWindow { days, from: parse_clock(from)?, until: parse_clock(until)? });
        }
        let calendar = Self { zone, windows };
        calendar
            .check()
            .map_err(|(_, reason)| MalformedCalendar::new(text, format!("is not possible: {reason}")))?;
        Ok(calendar)
    }
}

/// `Mon`, or `Fri-Mon`, in either case.
fn days_of(text: &str) -> Option<Vec<Weekday>> {
    let day = |name: &str| day_named(&name.to_ascii_lowercase());
    let Some((first, last)) = text.split_once('-') else { return Some(vec![day(text)?]) };
    let (first, last) = (day(first)?, day(last)?);
    Some(first.cycle_forward().take(first.until(last) as usize + 1).collect())
}

/// `Mon`.
fn short(day: Weekday) -> String {
    let (first, rest) = day_name(day).split_at(1);
    first.to_ascii_uppercase() + rest
}

impl fmt::Display for NodeCalendar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, window) in self.windows.iter().enumerate() {
            if index > 0 {
                write!(f, ", ")?;
            }
            let days: Vec<String> = window.days.iter().map(|&day| short(day)).collect();
            match &days[..] {
                [] => {}
                [one] => write!(f, "{one} ")?,
                [first, .., last] if days_of(&format!("{first}-{last}")).as_ref() == Some(&window.days) => {
                    write!(f, "{first}-{last} ")?;
                }
                _ => write!(f, "{} ", days.join("+"))?,
            }
            write!(f, "{}-{}", clock(window.from), clock(window.until))?;
        }
        write!(f, " {}", self.zone)
    }
}

/// What happens to a task that still runs when its node's window ends.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WindowEnd {
    /// It is finished; then the node sleeps.
    #[default]
    Finish,
    /// It is stopped and goes to another node.
    Stop,
}

impl WindowEnd {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            WindowEnd::Finish => "finish",
            WindowEnd::Stop => "stop",
        }
    }
}

/// A time span from `start` to just before `end`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TimeSpan {
    /// First instant.
    pub start: Timestamp,
    /// The instant after the last. Absent: unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub end: Option<Timestamp>,
}

/// Whether a node is awake by its calendar and its maintenance.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NodePower {
    /// Awake or asleep.
    pub state: PowerState,
    /// End of this state. Absent: more than two weeks ahead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Timestamp>,
}

/// Awake or asleep.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PowerState {
    /// It may work.
    Awake,
    /// It gets no tasks.
    Asleep,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calendars_are_read_as_people_write_them_and_written_the_same() {
        for text in [
            "Mon-Fri 20:00-08:00, Sat-Sun 00:00-00:00 Europe/Berlin",
            "20:00-08:00 UTC",
            "Fri-Mon 18:30-06:15 America/Sao_Paulo",
            "Sat 00:00-12:00 UTC",
        ] {
            let calendar: NodeCalendar = text.parse().unwrap();
            assert_eq!(calendar.to_string(), text);
            let json = serde_json::to_string(&calendar).unwrap();
            assert_eq!(serde_json::from_str::<NodeCalendar>(&json).unwrap(), calendar, "{json}");
        }
        let weekend: NodeCalendar = "fri-MON 18:00-06:00".parse().unwrap();
        assert_eq!(
            weekend.windows[0].days,
            [Weekday::Friday, Weekday::Saturday, Weekday::Sunday, Weekday::Monday]
        );
        assert_eq!(weekend.zone, "UTC");
        assert_eq!("always".parse::<NodeCalendar>().unwrap().to_string(), "00:00-00:00 UTC");
    }

    #[test]
    fn malformed_calendars_are_refused_in_one_line() {
        for text in [
            "",
            "nights",
            "24:00-08:00",
            "20:00",
            "Mon-Foo 20:00-08:00",
            "8:00-9:00",
            "20:00-08:00 Mars/Olympus",
            "a b c d",
        ] {
            let message = text.parse::<NodeCalendar>().unwrap_err().to_string();
            assert!(!message.contains('\n') && message.len() < 250, "{message}");
        }
        for json in [
            r#"{"from": "20:60", "until": "8:00"}"#,
            r#"{"days": ["Mon"], "from": "20:00", "until": "08:00"}"#,
        ] {
            assert!(serde_json::from_str::<NodeWindow>(json).is_err(), "{json}");
        }
    }
}
