//! Outlooks of booked jobs: why they wait, and the state of their promises.

use forelight_protocol::{Event, JobId, Promise, Timestamp, Waits};
use serde::{Deserialize, Serialize};

use crate::columns::Json;
use crate::database::Write;
use crate::error::{Result, StoreError};
use crate::events::{append, event};
use crate::policy::rebooking::promise_news;
use crate::writing::run;

/// Why a job waits, and the state of its promise.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct JobOutlook {
    /// Why it has not begun.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<Waits>,
    /// The state of its promise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
}

/// Keeps the outlooks of jobs, and writes an event for each promise that broke or is kept again.
pub(crate) async fn keep(write: &mut Write, outlooks: &[(JobId, JobOutlook)], now: Timestamp) -> Result<()> {
    for (job, outlook) in outlooks {
        let row = sqlx::query!("SELECT outlook, state FROM jobs WHERE id = ?", job.0)
            .fetch_optional(write.connection().await?)
            .await?;
        let row = row.ok_or(StoreError::NotFound("job"))?;
        let before = row.outlook.0;
        // A job that ended meanwhile has no outlook.
        if before == *outlook || row.state.0.is_final() {
            continue;
        }
        run!(write, "UPDATE jobs SET outlook = ? WHERE id = ?", Json(outlook), job.0);
        let Some((kind, message)) = promise_news(before.promise.as_ref(), outlook.promise.as_ref()) else {
            continue;
        };
        let (promise, message) = (outlook.promise.clone(), Some(message));
        append(write, Event { job_id: Some(*job), promise, message, ..event(kind, now) });
    }
    Ok(())
}
