//! Waits for conditions, with a time limit.

use std::time::{Duration, Instant};

/// Time between two calls.
const PAUSE: Duration = Duration::from_millis(40);

/// Calls `look` until it returns a value. Panics with `what` after `patience`, which should be generous: it
/// detects hangs and does not test speed.
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
