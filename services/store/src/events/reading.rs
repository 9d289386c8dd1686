//! Events, as people and streams ask for them.

use forelight_protocol::{Event, EventId, JobId, Timestamp};

use crate::database::Store;
use crate::error::Result;
use crate::events::{event_rows, last_id};

impl Store {
    /// The events after the event `after`, oldest first, at most `limit`; of one job, or of the whole farm.
    pub async fn events_after(&self, job: Option<JobId>, after: EventId, limit: u32) -> Result<Vec<Event>> {
        let rows = match job {
            Some(job) => {
                event_rows!("WHERE e.job_id = ? AND e.id > ? ORDER BY e.id LIMIT ?", job.0, after, limit)
                    .fetch_all(self.readers())
                    .await?
            }
            None => {
                event_rows!("WHERE e.id > ? ORDER BY e.id LIMIT ?", after, limit)
                    .fetch_all(self.readers())
                    .await?
            }
        };
        Ok(rows.into_iter().map(Event::from).collect())
    }

    /// When the newest event was written.
    pub(crate) async fn time_of_newest_event(&self) -> Result<Option<Timestamp>> {
        let at = sqlx::query_scalar!("SELECT at FROM events ORDER BY id DESC LIMIT 1")
            .fetch_optional(self.readers())
            .await?;
        Ok(at.map(Timestamp::from_micros))
    }

    /// The id of the newest event; 0 if there is none.
    pub async fn last_event_id(&self) -> Result<EventId> {
        last_id(&mut *self.readers().acquire().await?).await
    }
}
