//! CPU time of the calling thread.

use rustix::time::{ClockId, clock_gettime};

/// CPU time of the calling thread at one moment. The clock stops while the thread does not run.
#[derive(Clone, Copy)]
pub(crate) struct ThreadClock(u64);

impl ThreadClock {
    pub fn start() -> Self {
        Self(now())
    }

    /// CPU time since the start, in nanoseconds. Only valid on the thread that called `start`.
    pub fn nanos(self) -> u64 {
        now().saturating_sub(self.0)
    }
}

fn now() -> u64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    // Neither part of a thread's CPU time is negative.
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}
