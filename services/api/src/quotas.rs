//! How much of the service one token may take at the same time.
//!
//! Workers are not held to it: a thousand of them may share a token, and what they ask for is the farm's work.

use std::collections::HashMap;
use std::sync::Arc;

use forelight_protocol::{ProblemKind, Role};
use forelight_store::tokens::Principal;
use parking_lot::Mutex;

use crate::error::{ApiError, ApiResult};

/// Seconds until a client may retry.
const LATER: u32 = 2;

type Counts = Arc<Mutex<HashMap<[u8; 32], u64>>>;

/// Counts what each token takes.
#[derive(Clone, Default)]
pub(crate) struct Quotas {
    requests: Counts,
    upload_bytes: Counts,
}

/// What a token has taken. Dropping it gives that back.
pub(crate) struct InFlight {
    counts: Counts,
    token: [u8; 32],
    taken: u64,
}

impl Drop for InFlight {
    fn drop(&mut self) {
        let mut counts = self.counts.lock();
        if let Some(count) = counts.get_mut(&self.token) {
            *count = count.saturating_sub(self.taken);
            if *count == 0 {
                counts.remove(&self.token);
            }
        }
    }
}

fn take(counts: &Counts, token: [u8; 32], taken: u64, most: u64) -> Option<InFlight> {
    let mut held = counts.lock();
    let count = held.get(&token).copied().unwrap_or(0);
    let sum = count.saturating_add(taken);
    if sum > most {
        return None;
    }
    held.insert(token, sum);
    drop(held);
    Some(InFlight { counts: counts.clone(), token, taken })
}

impl Quotas {
    /// Counts a request among those that this caller has under way. `None` for a worker.
    pub fn request(&self, caller: &Principal, most: u64) -> ApiResult<Option<InFlight>> {
        if caller.role == Role::Worker {
            return Ok(None);
        }
        let full = || {
            let reason =
                format!("this token has {most} requests under way, which is the most; wait for some");
            ApiError::new(ProblemKind::TooManyRequests, reason).retry_after(LATER)
        };
        take(&self.requests, caller.token, 1, most).ok_or_else(full).map(Some)
    }

    /// Counts bytes among those that this caller is uploading. `None` for a worker.
    pub fn upload(&self, caller: &Principal, bytes: u64, most: u64) -> ApiResult<Option<InFlight>> {
        if caller.role == Role::Worker {
            return Ok(None);
        }
        let full = || {
            let reason = format!(
                "this token is uploading files already; together with this one they may have {most} bytes. \
                 Wait for the others"
            );
            ApiError::new(ProblemKind::TooManyRequests, reason).retry_after(LATER)
        };
        take(&self.upload_bytes, caller.token, bytes, most).ok_or_else(full).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use forelight_protocol::TokenId;

    use super::*;

    fn caller(role: Role, token: u8) -> Principal {
        let hash = [token; 32];
        Principal {
            role,
            projects: None,
            name: "a".to_owned(),
            hash,
            token: hash,
            session: None,
            node: None,
            token_id: TokenId::new(),
            expires_at: None,
            from: None,
        }
    }

    #[test]
    fn a_token_may_have_so_many_requests_and_gives_each_back_and_a_worker_is_not_counted() {
        let quotas = Quotas::default();
        let (viewer, other) = (caller(Role::Viewer, 1), caller(Role::Submitter, 2));
        let first = quotas.request(&viewer, 2).unwrap();
        let second = quotas.request(&viewer, 2).unwrap();
        let refused = quotas.request(&viewer, 2).err().unwrap();
        assert_eq!(refused.kind(), Some(ProblemKind::TooManyRequests));
        assert!(quotas.request(&other, 2).is_ok());
        drop(first);
        let third = quotas.request(&viewer, 2).unwrap();
        assert!(quotas.request(&viewer, 2).is_err());
        let worker = caller(Role::Worker, 3);
        assert!(quotas.request(&worker, 0).unwrap().is_none());
        drop((second, third));
        assert!(quotas.requests.lock().is_empty());
    }

    #[test]
    fn uploads_of_a_token_have_so_many_bytes_together() {
        let quotas = Quotas::default();
        let submitter = caller(Role::Submitter, 1);
        let first = quotas.upload(&submitter, 60, 100).unwrap();
        assert!(quotas.upload(&submitter, 41, 100).is_err());
        assert!(quotas.upload(&submitter, u64::MAX, 100).is_err());
        let second = quotas.upload(&submitter, 40, 100).unwrap();
        drop((first, second));
        assert!(quotas.upload(&submitter, 100, 100).is_ok());
    }
}
