//! Answers that take long to compute, such as the ladders of a job or the prices of its deadlines.
//!
//! Hazard: hundreds of people, or one script, could ask for them at once, and take the cores and the memory
//! that workers are waiting for. So:
//!
//! - each is made once for each version of what it rests on; those who ask meanwhile get the same;
//! - few are made at the same time, few others wait for their turn, and the rest is told to come back;
//! - once begun, one is made to its end, even if nobody waits for it any more: the next who asks finds it.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::ProblemKind;
use parking_lot::Mutex;
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use serde::Serialize;
use tokio::sync::{Semaphore, watch};

use crate::document::Document;
use crate::error::{ApiError, ApiResult};

/// Bytes of all answers that are kept.
const KEPT_BYTES: u64 = 16 << 20;

/// About how many answers these are.
const KEPT_ANSWERS: usize = 1024;

/// Longest wait for a turn.
const TURN: Duration = Duration::from_secs(20);

/// Seconds until a client may ask again.
const LATER: u32 = 3;

/// What an answer is, and the version of what it rests on.
pub(crate) type Key = [u8; 32];

/// The key of an answer that rests on these values.
pub(crate) fn key(rests_on: &impl Serialize) -> Key {
    // Numbers, strings and lists always have a JSON form.
    *blake3::hash(&serde_json::to_vec(rests_on).unwrap_or_default()).as_bytes()
}

#[derive(Clone)]
struct Length;

impl Weighter<Key, Document> for Length {
    fn weight(&self, _: &Key, document: &Document) -> u64 {
        document.len() as u64 + 64
    }
}

type Outcome = Option<ApiResult<Document>>;

/// Makes costly answers and keeps them.
pub(crate) struct Costly {
    kept: Cache<Key, Document, Length>,
    being_made: Mutex<HashMap<Key, watch::Receiver<Outcome>>>,
    turns: Semaphore,
    waiting: Arc<Semaphore>,
}

impl Costly {
    /// Makes so many answers at the same time, while so many others wait.
    pub fn new(at_once: usize, waiting: usize) -> Arc<Self> {
        let at_once = at_once.max(1);
        Arc::new(Self {
            kept: Cache::with_weighter(KEPT_ANSWERS, KEPT_BYTES, Length),
            being_made: Mutex::default(),
            turns: Semaphore::new(at_once),
            waiting: Arc::new(Semaphore::new(at_once + waiting)),
        })
    }

    /// The answer with this key. It is made if it is neither kept nor being made.
    pub async fn answer<F>(self: &Arc<Self>, key: Key, make: F) -> ApiResult<Document>
    where
        F: Future<Output = ApiResult<Document>> + Send + 'static,
    {
        if let Some(kept) = self.kept.get(&key) {
            return Ok(kept);
        }
        let mut outcome = self.begin(key, make)?;
        let made = outcome.wait_for(Option::is_some).await;
        made.ok().and_then(|made| made.clone()).unwrap_or_else(|| Err(failed()))
    }

    fn begin<F>(self: &Arc<Self>, key: Key, make: F) -> ApiResult<watch::Receiver<Outcome>>
    where
        F: Future<Output = ApiResult<Document>> + Send + 'static,
    {
        let mut being_made = self.being_made.lock();
        if let Some(outcome) = being_made.get(&key) {
            return Ok(outcome.clone());
        }
        let place = self.waiting.clone().try_acquire_owned().map_err(|_| too_many())?;
        let (tell, outcome) = watch::channel(None);
        being_made.insert(key, outcome.clone());
        let costly = self.clone();
        tokio::spawn(async move {
            // Dropped at the end of the task, also if making it panics.
            let _done = Done(&costly, key);
            let _place = place;
            let turn = tokio::time::timeout(TURN, costly.turns.acquire()).await;
            let made = match turn {
                Ok(Ok(_turn)) => make.await,
                _ => Err(too_many()),
            };
            if let Ok(document) = &made {
                costly.kept.insert(key, document.clone());
            }
            tell.send_replace(Some(made));
        });
        Ok(outcome)
    }
}

/// An answer that is no longer being made.
struct Done<'a>(&'a Costly, Key);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.being_made.lock().remove(&self.1);
    }
}

fn too_many() -> ApiError {
    let reason = "the service is computing other answers, and others are waiting; ask again soon";
    ApiError::new(ProblemKind::TooManyRequests, reason).retry_after(LATER)
}

fn failed() -> ApiError {
    ApiError::new(ProblemKind::Internal, "the answer could not be computed; the service's log says more")
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use axum::response::IntoResponse as _;
    use tokio::sync::Notify;

    use super::*;

    struct Maker {
        made: AtomicU32,
        open: Notify,
    }

    impl Maker {
        fn new() -> Arc<Self> {
            Arc::new(Self { made: AtomicU32::new(0), open: Notify::new() })
        }

        /// Waits until it may go on, then says how many were made before.
        fn make(self: &Arc<Self>) -> impl Future<Output = ApiResult<Document>> + Send + 'static {
            let maker = self.clone();
            async move {
                maker.open.notified().await;
                Document::json(&maker.made.fetch_add(1, Ordering::SeqCst))
            }
        }
    }

    fn number(document: ApiResult<Document>) -> u32 {
        document.unwrap().parsed().unwrap()
    }

    #[tokio::test]
    async fn an_answer_is_made_once_for_all_who_ask_and_for_those_who_ask_later() {
        let (costly, maker) = (Costly::new(1, 0), Maker::new());
        let ask = || costly.answer(key(&"a"), maker.make());
        let open = async {
            tokio::task::yield_now().await;
            maker.open.notify_one();
        };
        let (first, second, third, ()) = tokio::join!(ask(), ask(), ask(), open);
        assert_eq!([first, second, third].map(number), [0, 0, 0]);
        assert_eq!(number(ask().await), 0);
        maker.open.notify_one();
        assert_eq!(number(costly.answer(key(&"b"), maker.make()).await), 1, "another version is made");
    }

    #[tokio::test]
    async fn beyond_those_that_wait_askers_are_told_to_come_back_and_an_answer_is_made_though_its_asker_left()
    {
        let (costly, maker) = (Costly::new(1, 1), Maker::new());
        let leave = async |name: &'static str| {
            let mut asked = Box::pin(costly.answer(key(&name), maker.make()));
            assert!(futures::poll!(&mut asked).is_pending());
        };
        leave("first").await;
        leave("second").await;
        let refused = costly.answer(key(&"third"), maker.make()).await.unwrap_err();
        assert_eq!(refused.kind(), Some(ProblemKind::TooManyRequests));
        assert_eq!(refused.into_response().headers()["retry-after"], "3");
        maker.open.notify_one();
        let never = async { panic!("it is being made, or was") };
        assert_eq!(number(costly.answer(key(&"first"), never).await), 0);
        maker.open.notify_one();
        let never = async { panic!("it is being made, or was") };
        assert_eq!(number(costly.answer(key(&"second"), never).await), 1);
    }

    #[tokio::test]
    async fn a_failure_is_not_kept_and_a_panic_harms_one_asker() {
        let (costly, maker) = (Costly::new(1, 0), Maker::new());
        let fail = async { Err(ApiError::new(ProblemKind::Conflict, "not yet")) };
        let refused = costly.answer(key(&"a"), fail).await.unwrap_err();
        assert_eq!(refused.kind(), Some(ProblemKind::Conflict));
        let panics = async { panic!("on purpose") };
        let refused = costly.answer(key(&"a"), panics).await.unwrap_err();
        assert_eq!(refused.kind(), Some(ProblemKind::Internal));
        maker.open.notify_one();
        assert_eq!(number(costly.answer(key(&"a"), maker.make()).await), 0);
    }
}
