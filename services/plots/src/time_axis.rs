//! Axes over time. Instants are microseconds UTC.

const MINUTE: i64 = 60_000_000;
/// Steps between two ticks, minutes: from a minute to a year.
const STEPS: [i64; 15] =
    [1, 5, 15, 30, 60, 120, 360, 720, 1440, 2880, 7200, 14_400, 43_200, 144_000, 525_600];
/// The most steps on an axis.
const MOST_STEPS: i64 = 12;

/// Returns the ticks of an axis: the whole multiples of a round step between two instants.
pub fn time_ticks(from: i64, until: i64) -> Vec<i64> {
    let span = until.saturating_sub(from);
    let step = STEPS.iter().map(|minutes| minutes * MINUTE).find(|step| span / step <= MOST_STEPS);
    let step = step.unwrap_or(span / 10 + 1);
    let first = from.div_euclid(step).saturating_mul(step).checked_add(step);
    let ticks = std::iter::successors(first, |tick| tick.checked_add(step));
    ticks.take_while(|&tick| tick <= until).collect()
}

/// Formats day and time to the minute, such as `27 Mar 18:00`. Empty outside the calendar's range.
pub fn clock(instant: i64) -> String {
    jiff::Timestamp::from_microsecond(instant)
        .map_or_else(|_| String::new(), |at| at.strftime("%d %b %H:%M").to_string())
}

#[cfg(test)]
mod tests {
    use super::{MINUTE, clock, time_ticks};

    #[test]
    fn ticks_are_round_and_few() {
        let at = |text: &str| text.parse::<jiff::Timestamp>().expect("an instant").as_microsecond();
        let (from, until) = (at("2026-03-27T18:10:00Z"), at("2026-03-28T07:00:00Z"));
        let ticks: Vec<String> = time_ticks(from, until).into_iter().map(clock).collect();
        assert_eq!(ticks.len(), 13);
        assert_eq!((ticks[0].as_str(), ticks[12].as_str()), ("27 Mar 19:00", "28 Mar 07:00"));
        assert_eq!(time_ticks(0, 2 * MINUTE), [MINUTE, 2 * MINUTE]);
        for (from, until) in [(i64::MIN, i64::MAX), (0, i64::MAX), (5, 5), (0, 1)] {
            assert!(time_ticks(from, until).len() <= 21, "{from} to {until}");
        }
    }
}
