//! Sets of frames as text: `0-47` or `0,5,9-12`.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::ToSchema;

/// A non-empty set of frame numbers, as ranges and single numbers: `0-47` or `0,5,9-12`.
#[derive(Clone, PartialEq, Eq, Hash, Debug, ToSchema)]
#[schema(value_type = String, example = "0,5,9-12", pattern = "^[0-9]+(-[0-9]+)?(,[0-9]+(-[0-9]+)?)*$")]
pub struct FrameSet(Vec<RangeInclusive<u32>>);

/// A string that is not a set of frames.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("frames: `{part}` {reason}; write for example 0-47 or 0,5,9-12")]
pub struct MalformedFrames {
    part: String,
    reason: &'static str,
}

impl FrameSet {
    /// The frames from `first` to `last`, in either order.
    pub fn range(first: u32, last: u32) -> Self {
        Self(vec![first.min(last)..=first.max(last)])
    }

    /// The set of these frames. `None` if there are none.
    pub fn from_frames(frames: impl IntoIterator<Item = u32>) -> Option<Self> {
        let ranges: Vec<_> = frames.into_iter().map(|frame| frame..=frame).collect();
        if ranges.is_empty() { None } else { Some(Self(merged(ranges))) }
    }

    /// Number of frames. Does not iterate over them, so it is safe for enormous ranges.
    pub fn count(&self) -> u64 {
        self.0.iter().map(|range| u64::from(range.end() - range.start()) + 1).sum()
    }

    /// The frames, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.0.iter().cloned().flatten()
    }

    /// The highest frame number.
    pub fn last(&self) -> u32 {
        self.0.last().map_or(0, |range| *range.end())
    }

    /// The frame in the middle: as many frames come before it as after it, or one more. Does not iterate.
    pub fn middle(&self) -> u32 {
        let mut before = self.count() / 2;
        for range in &self.0 {
            let frames = u64::from(range.end() - range.start()) + 1;
            if before < frames {
                return range.start() + before as u32;
            }
            before -= frames;
        }
        self.last()
    }

    /// Whether `frame` is in the set.
    pub fn contains(&self, frame: u32) -> bool {
        self.0.iter().any(|range| range.contains(&frame))
    }
}

/// Sorts ranges, and joins those that overlap or touch.
fn merged(mut ranges: Vec<RangeInclusive<u32>>) -> Vec<RangeInclusive<u32>> {
    ranges.sort_by_key(|range| *range.start());
    let mut joined: Vec<RangeInclusive<u32>> = Vec::with_capacity(ranges.len());
    for range in ranges {
        match joined.last_mut() {
            Some(last) if *range.start() <= last.end().saturating_add(1) => {
                *last = *last.start()..=*last.end().max(range.end());
            }
            _ => joined.push(range),
        }
    }
    joined
}

impl FromStr for FrameSet {
    type Err = MalformedFrames;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut ranges = Vec::new();
        for part in text.split(',') {
            let malformed = |reason| MalformedFrames {
                part: part.chars().take(40).flat_map(char::escape_debug).collect(),
                reason,
            };
            let number = |digits: &str| {
                if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
                    return Err(malformed("is not a frame number or a range"));
                }
                digits.parse::<u32>().map_err(|_| malformed("exceeds the largest frame number, 4294967295"))
            };
            let part_trimmed = part.trim();
            let (first, last) = match part_trimmed.split_once('-') {
                Some((first, last)) => (number(first.trim())?, number(last.trim())?),
                None => (number(part_trimmed)?, number(part_trimmed)?),
            };
            if first > last {
                return Err(malformed("is a range that ends before it starts"));
            }
            ranges.push(first..=last);
        }
        Ok(Self(merged(ranges)))
    }
}

impl fmt::Display for FrameSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, range) in self.0.iter().enumerate() {
            if i > 0 {
                f.write_str(",")?;
            }
            if range.start() == range.end() {
                write!(f, "{}", range.start())?;
            } else {
                write!(f, "{}-{}", range.start(), range.end())?;
            }
        }
        Ok(())
    }
}

impl Serialize for FrameSet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for FrameSet {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        std::borrow::Cow::<'de, str>::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlapping_and_touching_parts_become_one_range() {
        let set: FrameSet = "9-12, 0,5,1,11-14,2".parse().unwrap();
        assert_eq!(set.to_string(), "0-2,5,9-14");
        assert_eq!(set.count(), 10);
        assert_eq!(set.iter().collect::<Vec<_>>(), [0, 1, 2, 5, 9, 10, 11, 12, 13, 14]);
        assert_eq!(set.last(), 14);
        assert!(set.contains(13) && !set.contains(6));
    }

    #[test]
    fn the_whole_range_of_numbers_is_counted_without_walking_it() {
        let set: FrameSet = "0-4294967295,4294967295".parse().unwrap();
        assert_eq!(set.count(), 1 << 32);
    }

    #[test]
    fn the_middle_is_found_without_a_walk() {
        let middle = |text: &str| text.parse::<FrameSet>().unwrap().middle();
        assert_eq!([middle("7"), middle("0-47"), middle("0,5,9-12")], [7, 24, 10]);
        assert_eq!(middle("0-4294967295"), 1 << 31);
    }

    #[test]
    fn malformed_lists_name_the_part_that_is_wrong() {
        for (text, part) in [
            ("", "``"),
            ("0,,1", "``"),
            ("0,x", "`x`"),
            ("5-2", "`5-2`"),
            ("1,+2", "`+2`"),
            ("0-4294967296", "`0-4294967296`"),
            ("1-2-3", "`1-2-3`"),
            ("1,2\n3", "`2\\n3`"),
        ] {
            let message = text.parse::<FrameSet>().unwrap_err().to_string();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
