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
                sqlx::query_as!(EventRow, "SELECT e.id, e.body, j.project AS \"project?\", j.name AS \"job_name?\" \
                     FROM events e LEFT JOIN jobs j ON j.id = e.job_id WHERE " + $rest $(, $value)*)
                    .fetch_all(self.readers())
                    .await?
            };
        }
        let rows = match job {
            Some(job) => rows!("e.job_id = ? AND e.id > ? ORDER BY e.id LIMIT ?", job.0, after, limit),
            None => rows!("e.id > ? ORDER BY e.id LIMIT ?", after, limit),
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
