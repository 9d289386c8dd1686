//! Requests end with the right by which they are made.
//!
//! The hazard: a token is checked when a request begins, and some requests last for hours. A stream of events
//! would go on after its token was revoked, a claim that waits would be given a task, and an upload would be
//! kept. So every request holds its right while it runs and while its answer is sent, and ends at once when
//! the right does.
//!
//! A right is taken hold of *before* it is looked up. If it ends after the lookup, the holder is told; if it
//! ended before, the lookup fails.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use axum::body::{Body, HttpBody as _};
use axum::extract::Request;
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use forelight_protocol::{ProblemKind, Timestamp};
use forelight_store::{EndOfRight, Store, StoreError};
use futures::StreamExt as _;
use parking_lot::Mutex;
use tokio::sync::SetOnce;
use tokio_util::sync::CancellationToken;

use crate::error::{ApiError, BAD_TOKEN};

/// A token's last use is stored at most once in this time: a minute, in microseconds.
const USE_NOTED: i64 = 60_000_000;

/// BLAKE3 hash of a token, or of a session's secret.
type Hash = [u8; 32];

/// The rights of the requests that are under way, and when tokens were last used.
#[derive(Default)]
pub(crate) struct Rights {
    live: Mutex<BTreeMap<Hash, Weak<Right>>>,
    used: Mutex<BTreeMap<Hash, Used>>,
    /// The newest ended right that was read.
    seen: tokio::sync::Mutex<Option<i64>>,
}

/// A right. All requests that live by it hold the same one.
#[derive(Default)]
pub(crate) struct Right {
    end: CancellationToken,
    expires_at: Mutex<Option<Timestamp>>,
}

#[derive(Clone, Copy)]
struct Used {
    at: Timestamp,
    noted: Option<Timestamp>,
}

impl Right {
    /// Says when the right ends by itself.
    pub fn until(&self, expires_at: Option<Timestamp>) {
        *self.expires_at.lock() = expires_at;
    }

    fn goes_on(&self, now: Timestamp) -> bool {
        self.expires_at.lock().is_none_or(|end| end > now)
    }

    /// Returns once the right has ended.
    async fn ended(&self) {
        self.end.cancelled().await;
    }
}

impl Rights {
    /// Takes hold of a right for a request.
    pub fn hold(&self, hash: Hash) -> Arc<Right> {
        let mut rights = self.live.lock();
        if let Some(right) = rights.get(&hash).and_then(Weak::upgrade) {
            return right;
        }
        let right = Arc::<Right>::default();
        rights.insert(hash, Arc::downgrade(&right));
        right
    }

    fn held(&self, hash: &Hash) -> Option<Arc<Right>> {
        self.live.lock().get(hash).and_then(Weak::upgrade)
    }

    /// Notes in memory that a token was used.
    pub fn note_use(&self, token: Hash, now: Timestamp) {
        let mut used = self.used.lock();
        let noted = used.get(&token).and_then(|used| used.noted);
        used.insert(token, Used { at: now, noted });
    }

    /// Stores the last uses of tokens, all of them in one write. `all`: also those stored less than a minute
    /// ago.
    pub async fn store_uses(&self, store: &Store, all: bool, now: Timestamp) -> Result<(), StoreError> {
        let is_old = |noted: Timestamp| now.micros_since(noted) >= USE_NOTED;
        let due: Vec<(Hash, Timestamp)> = {
            let mut used = self.used.lock();
            // Tokens at rest are forgotten.
            used.retain(|_, used| used.noted.is_none_or(|noted| noted != used.at || !is_old(noted)));
            let is_due =
                |used: &Used| used.noted.is_none_or(|noted| noted != used.at && (all || is_old(noted)));
            used.iter().filter(|(_, used)| is_due(used)).map(|(hash, used)| (*hash, used.at)).collect()
        };
        store.note_tokens_used(&due).await?;
        let mut used = self.used.lock();
        for (hash, at) in due {
            if let Some(used) = used.get_mut(&hash) {
                used.noted = Some(at);
            }
        }
        Ok(())
    }

    /// Ends the requests whose rights have ended since the last look.
    pub async fn look(&self, store: &Store, now: Timestamp) -> Result<(), StoreError> {
        self.expire(now);
        let mut seen = self.seen.lock().await;
        let ended = match *seen {
            Some(seen) => store.ended_rights(seen).await?,
            // Nothing was under way before the service started.
            None => {
                *seen = Some(store.newest_ended_right().await?);
                return Ok(());
            }
        };
        for ended in ended {
            if let Some(right) = self.held(&ended.hash) {
                match ended.is_over {
                    true => right.end.cancel(),
                    false => match store.end_of_right(&ended.hash).await? {
                        EndOfRight::Over => right.end.cancel(),
                        EndOfRight::At(end) => right.until(end),
                    },
                }
            }
            *seen = Some(ended.number);
        }
        self.expire(now);
        Ok(())
    }

    /// Ends what has expired, and forgets what nobody holds. An ended right is forgotten too: whoever comes
    /// after its end is refused by the lookup, or has a new right.
    fn expire(&self, now: Timestamp) {
        self.live.lock().retain(|_, right| {
            let Some(right) = right.upgrade() else { return false };
            if !right.goes_on(now) {
                right.end.cancel();
            }
            !right.end.is_cancelled()
        });
    }
}

/// The place where a request's caller leaves its hold.
pub(crate) type Held = Arc<SetOnce<Arc<Right>>>;

/// Ends the request, and the sending of its answer, when the caller's right ends.
pub(crate) async fn end_with_right(mut request: Request, next: Next) -> Response {
    let held = Held::default();
    request.extensions_mut().insert(held.clone());
    let ended = async { held.wait().await.ended().await };
    let response = tokio::select! {
        biased;
        () = ended => return over().into_response(),
        response = next.run(request) => response,
    };
    // An answer of known length is in memory, and is sent at once.
    if held.get().is_none() || response.body().size_hint().exact().is_some() {
        return response;
    }
    response.map(|body| {
        let ended = async move { held.wait().await.ended().await };
        Body::from_stream(body.into_data_stream().take_until(Box::pin(ended)))
    })
}

fn over() -> ApiError {
    let reason = "the token or the session ended while the request was answered";
    ApiError::new(ProblemKind::Unauthenticated, reason).authenticate(BAD_TOKEN)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_micros(seconds * 1_000_000)
    }

    #[test]
    fn a_right_ends_for_all_who_hold_it_and_is_forgotten_with_them() {
        let rights = Rights::default();
        let (one, other) = (rights.hold([1; 32]), rights.hold([1; 32]));
        let bystander = rights.hold([2; 32]);
        one.until(Some(at(10)));
        rights.expire(at(9));
        assert!(!other.end.is_cancelled());
        rights.expire(at(10));
        assert!(one.end.is_cancelled() && other.end.is_cancelled() && !bystander.end.is_cancelled());
        // Whoever comes after the end holds another right.
        let later = rights.hold([1; 32]);
        drop((one, other));
        rights.expire(at(11));
        assert!(!later.end.is_cancelled() && rights.held(&[1; 32]).is_some());
        drop((later, bystander));
        rights.expire(at(11));
        assert!(rights.live.lock().is_empty());
    }
}
