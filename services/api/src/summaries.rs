//! The farm in figures, made once for all streams that tell them.
//!
//! Otherwise each open page would ask for the dashboard a few seconds after an event.

use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::FarmSummary;
use tokio::sync::watch;
use tokio::time::Instant;

use crate::error::ApiResult;
use crate::resources::dashboard;
use crate::state::App;

/// What happens within this time after an event is told with it.
const TOGETHER: Duration = Duration::from_secs(1);

/// Shortest time between two summaries, or this many times what one took if that is longer.
const PACE: Duration = Duration::from_secs(3);
const PACE_TIMES: u32 = 10;

/// The newest summary, as streams send it.
pub(crate) struct Summaries(watch::Sender<Arc<str>>);

impl Default for Summaries {
    fn default() -> Self {
        Self(watch::Sender::new("".into()))
    }
}

impl Summaries {
    /// Summaries from now on.
    pub fn follow(&self) -> watch::Receiver<Arc<str>> {
        self.0.subscribe()
    }
}

/// A summary in the form of server-sent events. It has no id, so a client that returns names the last event.
pub(crate) fn lines(summary: &FarmSummary) -> Arc<str> {
    // Numbers, names and times always have a JSON form.
    format!("event: farm\ndata: {}\n\n", serde_json::to_string(summary).unwrap_or_default()).into()
}

/// Makes a summary after events, while a stream tells them.
pub(crate) async fn summarize(app: &App) {
    let mut changes = app.store.watch_events();
    let mut not_before = Instant::now();
    // Whether the last one was of a document that was made before the newest events.
    let mut is_behind = false;
    loop {
        let wait = async {
            if !is_behind {
                changes.changed().await?;
            }
            tokio::time::sleep_until(not_before.max(Instant::now() + TOGETHER)).await;
            Ok::<_, watch::error::RecvError>(())
        };
        tokio::select! {
            () = app.stopping.cancelled() => return,
            waited = wait => if waited.is_err() { return },
        }
        is_behind = false;
        if app.summaries.0.receiver_count() == 0 {
            continue;
        }
        changes.borrow_and_update();
        let begun = Instant::now();
        match send(app).await {
            Ok(farm_went_on) => is_behind = farm_went_on,
            Err(error) => {
                tracing::warn!(?error, "the farm could not be summarised; the next event tries again");
            }
        }
        not_before = Instant::now() + PACE.max(begun.elapsed() * PACE_TIMES);
    }
}

/// Sends a summary. Returns whether there are newer events.
async fn send(app: &App) -> ApiResult<bool> {
    let farm = dashboard::of_farm(app).await?;
    app.summaries.0.send_replace(farm.summary.clone());
    Ok(farm.last_event_id < app.store.last_event_id().await?)
}
