//! Where the time comes from.
//!
//! The system's clock can be set: by hand, by a time server that finds it wrong, by a machine that wakes up. A lease that lasts thirty
//! seconds must last thirty seconds all the same. So the service reads time from a [`SteadyClock`], which goes on by the
//! system's monotonic clock; the sweep looks at the difference once in a while, and when the clock was set it moves everything
//! that lies in the future along with it, in one transaction, before the service's time follows.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant};

use forelight_protocol::Timestamp;

/// A source of time. The service reads time nowhere else.
pub trait Clock: Send + Sync {
    /// The time of day, which may be set at any moment.
    fn now(&self) -> Timestamp;

    /// Time since some moment of the past, which only ever goes on, at the pace of time.
    fn elapsed(&self) -> Duration;
}

/// The system's clock.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock {
    start: Instant,
}

impl Default for SystemClock {
    fn default() -> Self {
        Self { start: Instant::now() }
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Timestamp {
        Timestamp::now()
    }

    fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }
}

/// A clock that stands still until it is moved, for tests.
#[derive(Debug)]
pub struct ManualClock {
    now: AtomicI64,
    elapsed: AtomicI64,
}

impl ManualClock {
    /// A clock that stands at this time.
    pub fn at(time: Timestamp) -> Self {
        Self { now: AtomicI64::new(time.micros()), elapsed: AtomicI64::new(0) }
    }

    /// Lets so many microseconds pass.
    pub fn advance_micros(&self, micros: i64) {
        self.elapsed.fetch_add(micros, Ordering::SeqCst);
        self.now.fetch_add(micros, Ordering::SeqCst);
    }

    /// Sets the time of day forward (back, if negative) by so many microseconds, without any passing.
    pub fn set_micros(&self, micros: i64) {
        self.now.fetch_add(micros, Ordering::SeqCst);
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Timestamp {
        Timestamp::from_micros(self.now.load(Ordering::SeqCst))
    }

    fn elapsed(&self) -> Duration {
        Duration::from_micros(self.elapsed.load(Ordering::SeqCst).unsigned_abs())
    }
}

/// The time of day as another clock had it when this one was made, or last followed it; it passes as time does.
pub(crate) struct SteadyClock {
    source: Arc<dyn Clock>,
    /// Time of day at which nothing had elapsed, in microseconds.
    origin: AtomicI64,
}

impl SteadyClock {
    pub fn new(source: Arc<dyn Clock>) -> Self {
        let origin = AtomicI64::new(origin(&*source));
        Self { source, origin }
    }

    /// By how many microseconds the other clock was set forward (back, if negative) since this one last followed it.
    pub fn set_by(&self) -> i64 {
        origin(&*self.source) - self.origin.load(Ordering::SeqCst)
    }

    /// Follows the other clock by this much.
    pub fn follow(&self, micros: i64) {
        self.origin.fetch_add(micros, Ordering::SeqCst);
    }
}

fn origin(clock: &dyn Clock) -> i64 {
    clock.now().plus_micros(-micros(clock.elapsed())).micros()
}

fn micros(duration: Duration) -> i64 {
    i64::try_from(duration.as_micros()).unwrap_or(i64::MAX)
}

impl Clock for SteadyClock {
    fn now(&self) -> Timestamp {
        Timestamp::from_micros(self.origin.load(Ordering::SeqCst)).plus_micros(micros(self.source.elapsed()))
    }

    fn elapsed(&self) -> Duration {
        self.source.elapsed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_clock_passes_as_time_does_and_follows_only_when_told() {
        let start = Timestamp::from_micros(1_800_000_000_000_000);
        let source = Arc::new(ManualClock::at(start));
        let steady = SteadyClock::new(source.clone());
        source.advance_micros(7);
        assert_eq!((steady.now(), steady.set_by()), (start.plus_micros(7), 0));
        source.set_micros(-3_600_000_000);
        source.advance_micros(1);
        assert_eq!((steady.now(), steady.set_by()), (start.plus_micros(8), -3_600_000_000));
        steady.follow(-3_600_000_000);
        assert_eq!((steady.now(), steady.set_by()), (source.now(), 0));
    }
}
