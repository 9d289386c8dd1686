//! The newest events, read once for all streams.
//!
//! On a busy farm hundreds of pages are told every event. If each of them read it from the database, the
//! readers that workers wait for would be busy with that. So the first stream that wants to know what is new
//! reads it, and the others get the same text.

use std::collections::VecDeque;
use std::sync::Arc;

use forelight_protocol::{Event, EventId, JobId};
use forelight_store::tokens::Principal;
use forelight_store::{Store, StoreError};
use tokio::sync::{Mutex, watch};

use crate::seen::without_others;

/// Number of events read at once, and sent before a stream looks again whether it goes on.
pub(crate) const BATCH: u32 = 200;

/// Number of events kept. A stream that is further behind reads the database.
const KEPT: usize = 4096;

/// An event as streams send it.
#[derive(Debug, PartialEq)]
pub(crate) struct Told {
    pub id: EventId,
    pub job: Option<JobId>,
    /// Whether its job is over with it.
    pub is_last: bool,
    /// The lines of the stream.
    pub lines: String,
    /// The project that it concerns.
    pub project: Option<String>,
    /// The lines for those who reach some projects only.
    pub without_others: String,
}

impl Told {
    /// What the caller is told of it; `None` if it is about another project.
    pub fn lines_for(&self, caller: &Principal) -> Option<&String> {
        match &self.project {
            _ if caller.reaches_all() => Some(&self.lines),
            Some(project) => caller.sees(project).then_some(&self.without_others),
            None => self.job.is_none().then_some(&self.without_others),
        }
    }
}

impl From<&Event> for Told {
    fn from(event: &Event) -> Self {
        Self {
            id: event.id,
            job: event.job_id,
            is_last: event.job_state.is_some_and(|state| state.is_final()),
            lines: lines(event),
            project: event.project.clone(),
            without_others: lines(&without_others(event)),
        }
    }
}

/// An event in the form of server-sent events (<https://html.spec.whatwg.org/#server-sent-events>). JSON has
/// no line breaks.
fn lines(event: &Event) -> String {
    let json = serde_json::to_string(event).unwrap_or_default();
    format!("id: {}\nevent: {}\ndata: {json}\n\n", event.id, event.kind.name())
}

/// Some events, oldest first.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Batch {
    pub events: Vec<Arc<Told>>,
    /// There are no others up to this one.
    pub until: EventId,
}

/// The newest events.
pub(crate) struct Feed {
    store: Store,
    changes: watch::Receiver<u64>,
    recent: Mutex<Option<Recent>>,
}

impl Feed {
    pub fn new(store: Store) -> Self {
        Self { changes: store.watch_events(), store, recent: Mutex::default() }
    }

    /// Events after `after` that were written before the newest change of [`Store::watch_events`].
    pub async fn after(&self, job: Option<JobId>, after: EventId) -> Result<Batch, StoreError> {
        let newest = {
            let mut recent = self.recent.lock().await;
            let recent = match recent.as_mut() {
                Some(recent) => recent,
                None => recent.insert(Recent::new(self.store.last_event_id().await?)),
            };
            self.catch_up(recent).await?;
            if let Some(batch) = recent.after(job, after) {
                return Ok(batch);
            }
            recent.newest
        };
        let mut batch = self.stored_after(job, after).await?;
        if batch.events.len() < BATCH as usize {
            batch.until = batch.until.max(newest);
        }
        Ok(batch)
    }

    /// Events after `after`, at most [`BATCH`], including those that nobody was told of yet.
    pub async fn stored_after(&self, job: Option<JobId>, after: EventId) -> Result<Batch, StoreError> {
        let stored = self.store.events_after(job, after, BATCH).await?;
        let events: Vec<Arc<Told>> = stored.iter().map(|event| Arc::new(Told::from(event))).collect();
        let until = events.last().map_or(after, |event| event.id);
        Ok(Batch { events, until })
    }

    /// May be given up at every wait: what was read until then is kept, and the rest is read next time.
    async fn catch_up(&self, recent: &mut Recent) -> Result<(), StoreError> {
        let version = *self.changes.borrow();
        if recent.version == Some(version) {
            return Ok(());
        }
        let newest = self.store.last_event_id().await?;
        if newest - recent.newest > KEPT as EventId {
            *recent = Recent::new(newest);
        }
        loop {
            let batch = self.stored_after(None, recent.newest).await?;
            let is_all = batch.events.len() < BATCH as usize;
            recent.push(batch.events);
            if is_all {
                recent.version = Some(version);
                return Ok(());
            }
        }
    }
}

/// All events after one.
struct Recent {
    after: EventId,
    events: VecDeque<Arc<Told>>,
    newest: EventId,
    /// The change of the database with which they were read.
    version: Option<u64>,
}

impl Recent {
    fn new(after: EventId) -> Self {
        Self { after, events: VecDeque::new(), newest: after, version: None }
    }

    fn push(&mut self, events: Vec<Arc<Told>>) {
        self.newest = events.last().map_or(self.newest, |event| event.id);
        self.events.extend(events);
        while self.events.len() > KEPT {
            self.after = self.events.pop_front().map_or(self.after, |event| event.id);
        }
    }

    /// `None` if some of them are not here any more.
    fn after(&self, job: Option<JobId>, after: EventId) -> Option<Batch> {
        if after < self.after {
            return None;
        }
        let seen = self.events.partition_point(|event| event.id <= after);
        let wanted = self.events.range(seen..).filter(|event| job.is_none() || event.job == job);
        let events: Vec<_> = wanted.take(BATCH as usize).cloned().collect();
        let is_all = events.len() < BATCH as usize;
        let until = events.last().filter(|_| !is_all).map_or(self.newest.max(after), |event| event.id);
        Some(Batch { events, until })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(id: EventId, job: Option<JobId>) -> Arc<Told> {
        let (lines, without_others) = (String::new(), String::new());
        Arc::new(Told { id, job, is_last: false, lines, project: None, without_others })
    }

    fn ids(batch: &Batch) -> Vec<EventId> {
        batch.events.iter().map(|event| event.id).collect()
    }

    #[test]
    fn a_stream_gets_what_it_has_not_seen_of_its_job_and_is_sent_away_if_that_is_gone() {
        let job = Some(JobId::new());
        let mut recent = Recent::new(10);
        assert_eq!(recent.after(None, 9), None);
        assert_eq!(recent.after(None, 10), Some(Batch { events: vec![], until: 10 }));
        // Numbers may be missing.
        recent.push(vec![told(11, job), told(13, None), told(14, job), told(15, None)]);
        assert_eq!(ids(&recent.after(None, 12).unwrap()), [13, 14, 15]);
        let of_job = recent.after(job, 11).unwrap();
        assert_eq!((ids(&of_job), of_job.until), (vec![14], 15));
        assert_eq!(recent.after(None, 99), Some(Batch { events: vec![], until: 99 }));
        let more: Vec<_> = (16..).take(KEPT - 3).map(|id| told(id, None)).collect();
        recent.push(more);
        assert_eq!((recent.after, recent.after(None, 10)), (11, None));
        let batch = recent.after(None, 11).unwrap();
        assert_eq!((batch.events.len(), batch.until), (BATCH as usize, batch.events[199].id));
    }
}
