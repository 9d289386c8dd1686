//! Waiting for what has to happen, with an end to the patience.

use std::time::{Duration, Instant};

/// Time between two looks.
const PAUSE: Duration = Duration::from_millis(40);

/// Calls `look` until it has an answer. Panics with `what` when `patience` is over. Make it generous: it only
/// ends a test that waits in vain, and does not test speed.
pub async fn eventually<T>(what: &str, patience: Duration, mut look: impl AsyncFnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look().await {
            return found;
        }
        assert!(start.elapsed() < patience, "waited {patience:?} in vain for {what}");
        tokio::time::sleep(PAUSE).await;
    }
}
