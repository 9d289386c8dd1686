//! Tasks that take longer than forecast: progress is part of the evidence.
//!
//! | beyond | without progress | then |
//! | --- | --- | --- |
//! | P95, at least [`LEAST_LATE`] | or of the whole | the task is late: the estimate and the promise take note |
//! | [`AGAIN`] times P95, at least [`LEAST_AGAIN`] | yes | it stalls: it is run on another node as well |
//! | [`LIMIT`] times P95, at least [`LEAST_LIMIT`] | whatever it says | its lease ends |
//!
//! The P95 is that of the frame on its node. A task without a forecast is never late: it stalls as if its P95
//! were [`UNKNOWN_P95`], and its lease ends after a day. Pauses do not count.

use forelight_forecast::UnderWay;
use forelight_protocol::Timestamp;

const SECOND: i64 = 1_000_000;
const MINUTE: i64 = 60 * SECOND;

/// No task is late before this time, because fetching its files may take as long. In microseconds, as all
/// here.
pub const LEAST_LATE: i64 = 10 * SECOND;

/// A task stalls after so many times its P95.
pub const AGAIN: i64 = 5;

/// No task stalls before this time.
pub const LEAST_AGAIN: i64 = MINUTE;

/// A lease ends after so many times the task's P95.
pub const LIMIT: i64 = 30;

/// No lease ends for its length before this time.
pub const LEAST_LIMIT: i64 = 15 * MINUTE;

/// The P95 of a task without a forecast.
pub const UNKNOWN_P95: i64 = 4 * MINUTE;

/// The lease of a task without a forecast ends after this time.
const UNKNOWN_LIMIT: i64 = 24 * 60 * MINUTE;

/// An attempt at a task.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct TaskAttempt {
    /// From when its time counts.
    pub since: Timestamp,
    /// How far it is, 0 to 1.
    pub progress: f64,
    /// Its last sign of progress: not before `since`.
    pub sign: Timestamp,
    /// How long the task takes on its node in 19 of 20 cases, in microseconds. `None` if nothing was
    /// forecast.
    pub p95: Option<i64>,
}

/// When an attempt began, and what is known of its time since.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct AttemptTimes {
    pub began: Timestamp,
    /// From when its time counts, if not from its begin.
    pub counts_from: Option<Timestamp>,
    /// When its progress last grew, if it did.
    pub progress_at: Option<Timestamp>,
}

impl AttemptTimes {
    pub(crate) fn new<T: Into<Timestamp>>(began: T, counts_from: Option<T>, progress_at: Option<T>) -> Self {
        let [counts_from, progress_at] = [counts_from, progress_at].map(|at| at.map(Into::into));
        Self { began: began.into(), counts_from, progress_at }
    }

    pub(crate) fn attempt(&self, progress: f64, p95: Option<i64>) -> TaskAttempt {
        let since = self.counts_from.map_or(self.began, |from| from.max(self.began));
        let sign = self.progress_at.map_or(since, |at| at.max(since));
        TaskAttempt { since, progress, sign, p95 }
    }
}

/// How late an attempt is, in the order of its course.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Lateness {
    OnTime,
    Late,
    Stalled,
    /// Beyond the farm's time limit.
    Over,
}

impl TaskAttempt {
    fn p95(&self) -> i64 {
        self.p95.unwrap_or(UNKNOWN_P95)
    }

    fn left(&self) -> f64 {
        1.0 - self.progress.clamp(0.0, 1.0)
    }

    /// When the task counts as stalled, if it makes no more progress.
    pub fn stalls_at(&self) -> Timestamp {
        self.sign.plus_micros(self.p95().saturating_mul(AGAIN).max(LEAST_AGAIN))
    }

    /// When its lease ends.
    pub fn ends_at(&self) -> Timestamp {
        let limit = self.p95.map_or(UNKNOWN_LIMIT, |p95| p95.saturating_mul(LIMIT).max(LEAST_LIMIT));
        self.since.plus_micros(limit)
    }

    /// How late it is at `now`.
    pub(crate) fn lateness(&self, now: Timestamp) -> Lateness {
        let rest = ((self.p95() as f64 * self.left()) as i64).max(LEAST_LATE);
        let whole = self.p95().max(LEAST_LATE);
        if now > self.ends_at() {
            Lateness::Over
        } else if now > self.stalls_at() {
            Lateness::Stalled
        } else if self.p95.is_some()
            && (now > self.sign.plus_micros(rest) || now > self.since.plus_micros(whole))
        {
            Lateness::Late
        } else {
            Lateness::OnTime
        }
    }

    /// When another attempt begins: once this one stalls or its lease ends, and now if none has begun since.
    fn second_attempt(&self, now: Timestamp) -> Timestamp {
        self.stalls_at().min(self.ends_at()).max(now)
    }

    /// When the task should be done that takes `length` microseconds on its node, given that it is not at
    /// `now`.
    ///
    /// Until it stalls, it is one of a few instants, so it does not move with the clock: the booked end; the
    /// end in 19, and in 99 of 100 cases; the end of a second attempt.
    pub fn expected_end(&self, length: i64, now: Timestamp) -> Timestamp {
        let part = |whole: f64| (whole * self.left()) as i64;
        let late = part(self.p95() as f64).max(LEAST_LATE);
        let rather_hangs = self.under_way(length).map_or(0.0, |task| task.rather_hangs_after());
        let ends = [
            self.sign.plus_micros(part(length as f64)),
            self.sign.plus_micros(late),
            self.sign.plus_micros((rather_hangs as i64).max(late)),
        ];
        let second = || self.second_attempt(now).plus_micros(length.max(1));
        ends.into_iter().find(|&end| end > now).unwrap_or_else(second)
    }

    /// Probability that the task is done by `deadline`, given that it is not at `now`.
    pub fn chance(&self, length: i64, deadline: Timestamp, now: Timestamp) -> f64 {
        let from_sign = |at: Timestamp| at.micros_since(self.sign) as f64;
        let if_it_hangs = self.second_attempt(now).plus_micros(length) <= deadline;
        match self.under_way(length) {
            Some(task) => task.chance(from_sign(now), from_sign(deadline), if_it_hangs),
            // All of it is done but the delivery.
            None => f64::from(u8::from(self.expected_end(length, now) <= deadline)),
        }
    }

    fn under_way(&self, length: i64) -> Option<UnderWay> {
        UnderWay::new(length as f64, self.p95() as f64, self.left())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_micros(seconds * SECOND)
    }

    /// Begun at 0, with a P95 of 100 s.
    fn attempt(progress: f64, sign: i64) -> TaskAttempt {
        TaskAttempt { since: at(0), progress, sign: at(sign), p95: Some(100 * SECOND) }
    }

    #[test]
    fn an_attempt_is_late_stalls_and_ends_at_multiples_of_its_p95() {
        let found = |now| attempt(0.0, 0).lateness(at(now));
        assert_eq!([100, 101].map(found), [Lateness::OnTime, Lateness::Late]);
        assert_eq!([500, 501].map(found), [Lateness::Late, Lateness::Stalled]);
        assert_eq!([3000, 3001].map(found), [Lateness::Stalled, Lateness::Over]);
        // Half of it is done: it has half of the time from there. Progress keeps it from stalling only.
        let half = |now| attempt(0.5, 40).lateness(at(now));
        assert_eq!([90, 91, 540, 541].map(half)[..2], [Lateness::OnTime, Lateness::Late]);
        assert_eq!([540, 541].map(half), [Lateness::Late, Lateness::Stalled]);
        assert_eq!(attempt(0.999, 3000).lateness(at(3001)), Lateness::Over);
    }

    #[test]
    fn short_tasks_have_time_and_tasks_without_a_forecast_a_day() {
        let short = TaskAttempt { p95: Some(100_000), ..attempt(0.0, 0) };
        let found = |now| short.lateness(at(now));
        assert_eq!([10, 11, 60, 61].map(found)[..2], [Lateness::OnTime, Lateness::Late]);
        assert_eq!([60, 61].map(found), [Lateness::Late, Lateness::Stalled]);
        assert_eq!([900, 901].map(found), [Lateness::Stalled, Lateness::Over]);
        let unknown = TaskAttempt { p95: None, ..attempt(0.0, 0) };
        assert_eq!(unknown.lateness(at(86_400)), Lateness::Stalled);
        assert_eq!(unknown.lateness(at(86_401)), Lateness::Over);
    }

    #[test]
    fn the_expected_end_moves_in_steps_until_a_second_attempt_is_due() {
        let length = 80 * SECOND;
        let mut ends: Vec<i64> =
            (0..=500).map(|now| attempt(0.0, 0).expected_end(length, at(now)).micros() / SECOND).collect();
        ends.dedup();
        assert_eq!(ends.len(), 4, "{ends:?}");
        assert_eq!((ends[0], ends[1], ends[3]), (80, 100, 580), "{ends:?}");
        assert!((0..3000).all(|now| attempt(0.0, 0).expected_end(length, at(now)) > at(now)));
        // Three quarters were done at 60 s.
        assert_eq!(attempt(0.75, 60).expected_end(length, at(61)), at(80));
    }

    #[test]
    fn the_chance_of_a_deadline_falls_while_nothing_happens_unless_a_second_attempt_makes_it() {
        let chance = |deadline: i64, now: i64| attempt(0.0, 0).chance(80 * SECOND, at(deadline), at(now));
        let near: Vec<f64> = [0, 90, 120, 200].map(|now| chance(300, now)).into();
        assert!(near[0] > 0.98 && near.windows(2).all(|pair| pair[1] < pair[0]), "{near:?}");
        assert!(near[3] < 0.05, "{near:?}");
        assert!(chance(600, 200) > 0.95, "the second attempt ends at 580 s");
        assert_eq!(chance(300, 300), 0.0);
    }

    #[test]
    fn once_an_attempt_stalls_the_next_begins_now_for_the_chance_and_for_the_expected_end() {
        let length = 80 * SECOND;
        // It stalls at 500 s, and its lease ends at 3,000 s.
        for now in [500, 510, 570, 590, 2000, 3100] {
            let task = attempt(0.0, 0);
            let end = task.expected_end(length, at(now));
            assert_eq!(end, at(now + 80));
            assert!(task.chance(length, end, at(now)) > 0.95, "at {now} s");
            assert!(task.chance(length, at(now + 79), at(now)) < 0.05, "at {now} s");
        }
        // One whose lease ends before it would stall is done again from there.
        assert_eq!(attempt(0.5, 2900).expected_end(length, at(2990)), at(3080));
    }
}
