//! Events, as people and streams ask for them.

use forelight_protocol::{Event, EventId, JobId, Timestamp};

use crate::database::Store;
use crate::error::Result;
use crate::events::{EventRow, last_id};

impl Store {
    /// The events after the event `after`, oldest first, at most `limit`; of one job, or of the whole farm.
    pub async fn events_after(&self, job: Option<JobId>, after: EventId, limit: u32) -> Result<Vec<Event>> {
        macro_rules! rows {
            ($rest:literal $(, $value:expr)*) => {
                sqlx::query_as!(EventRow, "SELECT id, body, (SELECT project FROM jobs j WHERE j.id = events.job_id) \
                     AS \"project?: String\" FROM events WHERE " + $rest $(, $value)*)
                    .fetch_all(self.readers())
                    .await?
            };
        }
        let rows = match job {
            Some(job) => rows!("job_id = ? AND id > ? ORDER BY id LIMIT ?", job.0, after, limit),
            None => rows!("id > ? ORDER BY id LIMIT ?", after, limit),
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
