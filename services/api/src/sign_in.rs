//! Holds back those who try to sign in too often with wrong secrets.
//!
//! Codes and tokens have 244 random bits, so guessing is hopeless anyway. This keeps a broken script from
//! trying all day.

use std::collections::BTreeMap;
use std::net::IpAddr;

use forelight_protocol::{ProblemKind, Timestamp};
use parking_lot::Mutex;

use crate::error::{ApiError, ApiResult};

/// Wrong secrets that an address may send in [`WINDOW`].
const MOST_FAILURES: u32 = 10;

/// In microseconds: a minute.
const WINDOW: i64 = 60_000_000;

/// Addresses that are remembered. When there are more, those beyond are counted together.
const MOST_ADDRESSES: usize = 10_000;

/// Failed attempts to sign in, by the address of the sender. Behind a proxy, all have that of the proxy.
#[derive(Debug, Default)]
pub(crate) struct SignIns(Mutex<BTreeMap<Option<IpAddr>, Failures>>);

#[derive(Clone, Copy, Debug)]
struct Failures {
    count: u32,
    since: Timestamp,
}

impl SignIns {
    /// Refuses an address that failed too often lately.
    pub fn check(&self, from: Option<IpAddr>, now: Timestamp) -> ApiResult<()> {
        let failed = self.0.lock();
        let Some(found) = failed.get(&from).or(failed.get(&None)) else { return Ok(()) };
        let left = found.since.plus_micros(WINDOW).micros_since(now);
        if found.count < MOST_FAILURES || left <= 0 {
            return Ok(());
        }
        let seconds = u32::try_from(left.saturating_add(999_999) / 1_000_000).unwrap_or(u32::MAX);
        let reason = "too many attempts to sign in failed; try again later";
        Err(ApiError::new(ProblemKind::TooManyRequests, reason).retry_after(seconds))
    }

    /// Counts a failure.
    pub fn failed(&self, from: Option<IpAddr>, now: Timestamp) {
        let mut failed = self.0.lock();
        if failed.len() >= MOST_ADDRESSES {
            failed.retain(|_, found| now.micros_since(found.since) < WINDOW);
        }
        let from = from.filter(|_| failed.len() < MOST_ADDRESSES);
        let found = failed.entry(from).or_insert(Failures { count: 0, since: now });
        if now.micros_since(found.since) >= WINDOW {
            *found = Failures { count: 0, since: now };
        }
        found.count = found.count.saturating_add(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_failures_a_minute_are_enough_and_do_not_count_against_others() {
        let (sign_ins, here) = (SignIns::default(), Some(IpAddr::from([10, 0, 0, 1])));
        let at = |seconds: i64| Timestamp::from_micros(seconds * 1_000_000);
        for second in 0..10 {
            assert!(sign_ins.check(here, at(second)).is_ok(), "{second}");
            sign_ins.failed(here, at(second));
        }
        let refused = sign_ins.check(here, at(10)).unwrap_err();
        assert_eq!(refused.kind(), Some(ProblemKind::TooManyRequests));
        assert!(sign_ins.check(Some(IpAddr::from([10, 0, 0, 2])), at(10)).is_ok());
        assert!(sign_ins.check(here, at(60)).is_ok());
    }

    #[test]
    fn what_is_remembered_of_strangers_is_bounded() {
        let sign_ins = SignIns::default();
        let now = Timestamp::from_micros(0);
        for number in 0..2 * MOST_ADDRESSES as u32 {
            sign_ins.failed(Some(IpAddr::from(number.to_be_bytes())), now);
        }
        assert!(sign_ins.0.lock().len() <= MOST_ADDRESSES + 1);
        assert!(sign_ins.check(Some(IpAddr::from([255, 0, 0, 1])), now).is_err(), "the rest share a count");
    }
}
