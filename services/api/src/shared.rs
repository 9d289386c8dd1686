//! Documents that are costly to make, and that many people ask for at the same time.
//!
//! On a farm with thousands of nodes, a look at all bookings takes a good part of a second. Hundreds of pages
//! ask for it when something happens. So one request makes it, and those that came meanwhile get the same.
//! If it took long, it is also given to later ones for a while, so that it takes at most a tenth of the time.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Mutex;
use tokio::time::Instant;

use crate::error::ApiResult;

/// A document that took less is made again for each request that comes after it was begun.
const QUICK: Duration = Duration::from_millis(100);

/// A slow document is kept for this many times the time by which it was not quick.
const KEPT_TIMES: u32 = 10;

/// When something last changed that documents must show, however short they are kept.
#[derive(Clone)]
pub(crate) struct Changes(Arc<parking_lot::Mutex<Times>>);

#[derive(Clone, Copy)]
struct Times {
    people: Instant,
    plan: Instant,
}

impl Changes {
    pub fn new() -> Self {
        let now = Instant::now();
        Self(Arc::new(parking_lot::Mutex::new(Times { people: now, plan: now })))
    }

    /// A person changed something through this service. People see what they did.
    pub fn by_person(&self) {
        self.0.lock().people = Instant::now();
    }

    /// A plan was stored. What is said of jobs must not be half of the plan before.
    pub fn by_plan(&self) {
        self.0.lock().plan = Instant::now();
    }

    /// The last change by a person.
    pub fn of_people(&self) -> Instant {
        self.0.lock().people
    }

    /// The last change of either kind.
    pub fn last(&self) -> Instant {
        let Times { people, plan } = *self.0.lock();
        people.max(plan)
    }
}

/// A document that those share who ask at the same time.
pub(crate) struct Shared<T>(Mutex<Option<Made<T>>>);

struct Made<T> {
    document: Arc<T>,
    begun: Instant,
    took: Duration,
}

impl<T> Default for Shared<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<T> Made<T> {
    /// Whether it may be given to somebody who asked at `asked`. `changed` is when something last changed
    /// that it must show.
    fn will_do(&self, asked: Instant, changed: Instant, now: Instant) -> bool {
        let kept_until = self.begun + self.took + self.took.saturating_sub(QUICK) * KEPT_TIMES;
        self.begun >= asked || (self.begun > changed && now < kept_until)
    }
}

impl<T> Shared<T> {
    /// The document. It is made now unless one will do that was made before.
    pub async fn get(&self, changed: Instant, make: impl Future<Output = ApiResult<T>>) -> ApiResult<Arc<T>> {
        let asked = Instant::now();
        let mut made = self.0.lock().await;
        if let Some(made) = made.as_ref().filter(|made| made.will_do(asked, changed, Instant::now())) {
            return Ok(made.document.clone());
        }
        let begun = Instant::now();
        let document = Arc::new(make.await?);
        *made = Some(Made { document: document.clone(), begun, took: begun.elapsed() });
        Ok(document)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use tokio::sync::Semaphore;

    use super::*;

    #[test]
    fn a_quick_document_is_made_each_time_and_a_slow_one_kept_until_somebody_changes_something() {
        let start = Instant::now();
        let at = |millis: u64| start + Duration::from_millis(millis);
        let made =
            |took: u64| Made { document: Arc::new(()), begun: at(1000), took: Duration::from_millis(took) };
        // Whoever asked before it was begun may have it, whatever happened since.
        assert!(made(1).will_do(at(999), at(1001), at(9999)));
        assert!(!made(100).will_do(at(1101), at(0), at(1101)), "it was quick");
        // It took 200 ms more than a quick one.
        assert!(made(300).will_do(at(1301), at(0), at(3299)));
        assert!(!made(300).will_do(at(1301), at(0), at(3300)));
        assert!(!made(300).will_do(at(1301), at(1001), at(1302)), "somebody changed something");
    }

    #[tokio::test]
    async fn those_who_ask_while_a_document_is_made_share_the_next_one() {
        let (shared, made, gate) = (Shared::default(), AtomicU32::new(0), Semaphore::new(0));
        let long_ago = Instant::now();
        let ask = async || {
            let make = async {
                let _turn = gate.acquire().await;
                Ok(made.fetch_add(1, Ordering::SeqCst))
            };
            *shared.get(long_ago, make).await.unwrap_or_else(|_| panic!("it is made"))
        };
        let open = async {
            tokio::task::yield_now().await;
            gate.add_permits(1);
        };
        let (first, second, third, ()) = tokio::join!(ask(), ask(), ask(), open);
        assert_eq!((first, second, third), (0, 1, 1));
    }
}
