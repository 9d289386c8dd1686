//! The wait before the next attempt.

use std::time::Duration;

/// Exponential back-off with full jitter. The wait after failure *n* is uniform in [0, min(`longest`, `first`
/// · 2ⁿ⁻¹)]. So workers that lost the service together do not all return at the same moment.
#[derive(Debug, Clone)]
pub struct Backoff {
    /// Upper limit of the first wait.
    pub first: Duration,
    /// Upper limit of all later waits.
    pub longest: Duration,
    /// Number of attempts, including the first. `None` never gives up.
    pub attempts: Option<u32>,
}

impl Backoff {
    /// For a person who waits. Gives up after about ten seconds.
    pub const PATIENT: Self =
        Self { first: Duration::from_millis(100), longest: Duration::from_secs(4), attempts: Some(7) };

    /// For a worker with a result to deliver. Waits until the service is back.
    pub const FOREVER: Self =
        Self { first: Duration::from_millis(100), longest: Duration::from_secs(5), attempts: None };

    /// The wait after `failures` failed attempts. `None` gives up.
    ///
    /// `fraction` in [0, 1) is the jitter. `asked` is the wait from `Retry-After`. It is added to the
    /// jittered wait, up to a minute.
    pub fn wait(&self, failures: u32, fraction: f64, asked: Option<Duration>) -> Option<Duration> {
        /// Longest wait that a service can ask for.
        const LONGEST_ASKED: Duration = Duration::from_secs(60);
        if self.attempts.is_some_and(|attempts| failures >= attempts) {
            return None;
        }
        let doublings = failures.saturating_sub(1).min(30);
        let ceiling = self.first.saturating_mul(1 << doublings).min(self.longest);
        let jittered = ceiling.mul_f64(fraction.clamp(0.0, 1.0));
        Some(asked.map_or(jittered, |asked| asked.min(LONGEST_ASKED) + jittered))
    }

    /// [`Self::wait`] with a random jitter.
    pub fn jittered(&self, failures: u32, asked: Option<Duration>) -> Option<Duration> {
        self.wait(failures, rand::random::<f64>(), asked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_longest_and_then_end() {
        let backoff =
            Backoff { first: Duration::from_millis(100), longest: Duration::from_secs(1), attempts: Some(6) };
        let waits: Vec<Option<u128>> =
            (1..=6).map(|n| backoff.wait(n, 1.0, None).map(|d| d.as_millis())).collect();
        assert_eq!(waits, [Some(100), Some(200), Some(400), Some(800), Some(1000), None]);
    }

    #[test]
    fn a_worker_never_gives_up_and_never_overflows() {
        for failures in [1, 40, u32::MAX] {
            let wait = Backoff::FOREVER.wait(failures, 1.0, None).unwrap();
            assert!(wait <= Backoff::FOREVER.longest);
        }
    }

    #[test]
    fn the_wait_that_the_service_asks_for_is_kept_but_bounded() {
        let asked = |seconds| Backoff::PATIENT.wait(1, 0.5, Some(Duration::from_secs(seconds))).unwrap();
        assert!(asked(3) >= Duration::from_secs(3));
        assert!(asked(1_000_000) < Duration::from_secs(62));
    }
}
