//! When a node is awake: weekly windows of the wall clock, less its maintenance.

use std::fmt;
use std::str::FromStr;

use jiff::tz::TimeZone;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::ToSchema;

use crate::Timestamp;

/// Most windows of a calendar.
pub const MOST_WINDOWS: usize = 50;

/// A day of the week.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Day {
    /// Monday.
    Mon,
    /// Tuesday.
    Tue,
    /// Wednesday.
    Wed,
    /// Thursday.
    Thu,
    /// Friday.
    Fri,
    /// Saturday.
    Sat,
    /// Sunday.
    Sun,
}

impl Day {
    /// All days, Monday first.
    pub const ALL: [Day; 7] = [Day::Mon, Day::Tue, Day::Wed, Day::Thu, Day::Fri, Day::Sat, Day::Sun];

    /// `Mon`.
    pub const fn short(self) -> &'static str {
        ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun"][self as usize]
    }

    fn from_short(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|day| day.short().eq_ignore_ascii_case(text))
    }
}

/// A time of the wall clock, to the minute: `20:00`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, ToSchema)]
#[schema(value_type = String, pattern = "^([01][0-9]|2[0-3]):[0-5][0-9]$", example = "20:00")]
pub struct ClockTime(u16);

impl ClockTime {
    /// 00:00.
    pub const MIDNIGHT: Self = Self(0);

    /// 0 to 23.
    pub const fn hour(self) -> u8 {
        (self.0 / 60) as u8
    }

    /// 0 to 59.
    pub const fn minute(self) -> u8 {
        (self.0 % 60) as u8
    }
}

impl fmt::Display for ClockTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:02}:{:02}", self.hour(), self.minute())
    }
}

impl FromStr for ClockTime {
    type Err = MalformedCalendar;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let two = |part: &str, most: u16| {
            let digits = part.len() == 2 && part.bytes().all(|byte| byte.is_ascii_digit());
            part.parse().ok().filter(|&number: &u16| digits && number <= most)
        };
        let (hour, minute) = text.split_once(':').unwrap_or((text, ""));
        match (two(hour, 23), two(minute, 59)) {
            (Some(hour), Some(minute)) => Ok(Self(hour * 60 + minute)),
            _ => Err(MalformedCalendar::new(text, "is not a time of day, such as 20:00")),
        }
    }
}

impl Serialize for ClockTime {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for ClockTime {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = std::borrow::Cow::<'de, str>::deserialize(deserializer)?;
        text.parse().map_err(D::Error::custom)
    }
}

/// A window that repeats every week.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeWindow {
    /// Days on which it opens. Empty means every day.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 7)]
    pub days: Vec<Day>,
    /// When it opens.
    pub from: ClockTime,
    /// When it closes: on the next day if not after `from`. Equal times are a whole day.
    pub until: ClockTime,
}

/// When a node is awake, in wall-clock time of its time zone, with daylight saving.
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
    /// Checks numbers and time zone. The error is the field and the reason.
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

/// Parses windows with commas between them, then the time zone, UTC if absent: `Mon-Fri 20:00-08:00, Sat-Sun
/// 00:00-00:00 Europe/Berlin`. A window without days is for every day. `always` is all the time.
impl FromStr for NodeCalendar {
    type Err = MalformedCalendar;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const SHAPE: &str =
            "is not a calendar, such as `Mon-Fri 20:00-08:00, Sat-Sun 00:00-00:00 Europe/Berlin`";
        let malformed = || MalformedCalendar::new(text, SHAPE);
        if text.trim() == "always" {
            let window =
                NodeWindow { days: Vec::new(), from: ClockTime::MIDNIGHT, until: ClockTime::MIDNIGHT };
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
            windows.push(NodeWindow { days, from: from.parse()?, until: until.parse()? });
        }
        let calendar = Self { zone, windows };
        calendar
            .check()
            .map_err(|(_, reason)| MalformedCalendar::new(text, format!("is invalid: {reason}")))?;
        Ok(calendar)
    }
}

/// `Mon`, or `Fri-Mon`.
fn days_of(text: &str) -> Option<Vec<Day>> {
    let Some((first, last)) = text.split_once('-') else { return Some(vec![Day::from_short(text)?]) };
    let (first, last) = (Day::from_short(first)? as usize, Day::from_short(last)? as usize);
    let count = (last + 7 - first) % 7 + 1;
    Some((0..count).map(|step| Day::ALL[(first + step) % 7]).collect())
}

impl fmt::Display for NodeCalendar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, window) in self.windows.iter().enumerate() {
            if index > 0 {
                write!(f, ", ")?;
            }
            let days: Vec<&str> = window.days.iter().map(|day| day.short()).collect();
            match days[..] {
                [] => {}
                [one] => write!(f, "{one} ")?,
                [first, .., last] if days_of(&format!("{first}-{last}")).as_ref() == Some(&window.days) => {
                    write!(f, "{first}-{last} ")?;
                }
                _ => write!(f, "{} ", days.join("+"))?,
            }
            write!(f, "{}-{}", window.from, window.until)?;
        }
        write!(f, " {}", self.zone)
    }
}

/// What happens to a task that is still running when its node's window ends.
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
    /// The instant after the last. Absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub end: Option<Timestamp>,
}

/// Whether a node is awake by its calendar and its maintenance.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NodePower {
    /// Awake or asleep.
    pub state: PowerState,
    /// End of this state. Absent if more than two weeks away.
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
        assert_eq!(weekend.windows[0].days, [Day::Fri, Day::Sat, Day::Sun, Day::Mon]);
        assert_eq!(weekend.zone, "UTC");
        assert_eq!("always".parse::<NodeCalendar>().unwrap().to_string(), "00:00-00:00 UTC");
    }

    #[test]
    fn what_is_no_calendar_is_refused_in_one_line() {
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
        assert!(serde_json::from_str::<ClockTime>("\"20:60\"").is_err());
    }
}
