//! Source of the time.
//!
//! The system's clock can jump, but a lease of thirty seconds must last thirty seconds. So the service reads
//! a [`SteadyClock`], which follows the monotonic clock. After a jump the sweep moves all future ends in one
//! transaction, then the service's time.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant};

use forelight_protocol::Timestamp;

/// A source of time, the only one that the service reads.
pub trait Clock: Send + Sync {
    /// Time of day. It can be set at any moment.
    fn now(&self) -> Timestamp;

    /// Time since a fixed moment in the past. It never goes back or jumps.
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

/// A clock for tests that stands still until it is moved.
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

    /// Lets time pass, in microseconds.
    pub fn advance_micros(&self, micros: i64) {
        self.elapsed.fetch_add(micros, Ordering::SeqCst);
        self.now.fetch_add(micros, Ordering::SeqCst);
    }

    /// Sets the time of day by this many microseconds, back if negative. No time passes.
    pub fn set_by(&self, micros: i64) {
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

/// Time of day of another clock when this one was made or last followed it, plus the time elapsed since.
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

    /// Microseconds by which the other clock was set since this one last followed it; negative if back.
    pub fn set_by(&self) -> i64 {
        origin(&*self.source) - self.origin.load(Ordering::SeqCst)
    }

    /// Follows the other clock by this many microseconds.
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
        source.set_by(-3_600_000_000);
        source.advance_micros(1);
        assert_eq!((steady.now(), steady.set_by()), (start.plus_micros(8), -3_600_000_000));
        steady.follow(-3_600_000_000);
        assert_eq!((steady.now(), steady.set_by()), (source.now(), 0));
    }
}
