//! Room on the disk for uploads, reserved before they take it.
//!
//! Hazard: unfinished uploads could fill the disk, and the farm would then hand out no task. So an upload is
//! accepted only if all of it fits beside all others that were accepted, and leaves what the farm needs.

use std::sync::Arc;

use axum::body::Bytes;
use axum::http::HeaderMap;
use forelight_protocol::ProblemKind;
use forelight_store::{Store, StoreError};
use futures::{Stream, StreamExt as _};
use parking_lot::Mutex;

use crate::error::{ApiError, ApiResult};
use crate::extract::announced_length;

/// An upload without an announced length reserves so many bytes at a time.
const STEP: u64 = 8 << 20;

/// Bytes that were reserved and are not written yet.
#[derive(Clone, Default)]
pub(crate) struct Reserved(Arc<Mutex<u64>>);

/// The reservation of one upload. Dropping it frees what was not written.
pub(crate) struct Reservation {
    all: Reserved,
    store: Store,
    /// Bytes that uploads of this kind leave free.
    leave: u64,
    /// Reserved for this upload and not written yet.
    ahead: u64,
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut all = self.all.0.lock();
        *all = all.saturating_sub(self.ahead);
    }
}

impl Reserved {
    /// Reserves room for an upload of at most `most` bytes: the announced length, or a first step.
    pub fn begin(&self, store: &Store, headers: &HeaderMap, most: u64, leave: u64) -> ApiResult<Reservation> {
        let bytes = announced_length(headers).unwrap_or(STEP).min(most);
        let mut reservation = Reservation { all: self.clone(), store: store.clone(), leave, ahead: 0 };
        if reservation.reserve(bytes)? {
            return Ok(reservation);
        }
        let [bytes, leave] = [bytes, leave].map(|bytes| format!("{} MiB", bytes.div_ceil(1 << 20)));
        let reason = format!(
            "the disk has no room for {bytes} beside other uploads and the {leave} that the farm needs"
        );
        Err(ApiError::new(ProblemKind::StorageFull, reason))
    }
}

impl Reservation {
    /// Reserves more bytes. Whether there is room.
    fn reserve(&mut self, bytes: u64) -> Result<bool, StoreError> {
        let free = self.store.free_disk_space()?;
        let mut all = self.all.0.lock();
        if all.saturating_add(bytes).saturating_add(self.leave) > free {
            return Ok(false);
        }
        *all += bytes;
        self.ahead += bytes;
        Ok(true)
    }

    /// Bytes are about to be written.
    fn write(&mut self, bytes: u64) -> Result<(), StoreError> {
        if bytes > self.ahead && !self.reserve(STEP.max(bytes - self.ahead))? {
            return Err(StoreError::Full);
        }
        let mut all = self.all.0.lock();
        self.ahead = self.ahead.saturating_sub(bytes);
        *all = all.saturating_sub(bytes);
        Ok(())
    }

    /// The upload's bytes, as far as there is room for them.
    pub fn fill<E: std::fmt::Display>(
        mut self,
        content: impl Stream<Item = Result<Bytes, E>>,
    ) -> impl Stream<Item = Result<Bytes, StoreError>> {
        content.map(move |chunk| {
            let chunk = chunk.map_err(|error| StoreError::BrokenOff(error.to_string()))?;
            self.write(chunk.len() as u64)?;
            Ok(chunk)
        })
    }
}

#[cfg(test)]
mod tests {
    use axum::http::header::CONTENT_LENGTH;
    use futures::stream;

    use super::*;

    fn length(bytes: u64) -> HeaderMap {
        HeaderMap::from_iter([(CONTENT_LENGTH, bytes.into())])
    }

    #[tokio::test]
    async fn uploads_are_refused_that_do_not_fit_beside_the_others_and_what_is_freed_can_be_had_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        // Others write to the disk meanwhile, so the sizes are far from each other.
        let free = store.free_disk_space().unwrap();
        let reserved = Reserved::default();
        let begin = |bytes: u64| reserved.begin(&store, &length(bytes), u64::MAX, free / 4);
        let first = begin(free / 2).unwrap();
        let refused = begin(free / 2).err().unwrap();
        assert_eq!(refused.kind(), Some(ProblemKind::StorageFull));
        let second = begin(free / 16).unwrap();
        drop(first);
        drop((begin(free / 2).unwrap(), second));
        assert_eq!(*reserved.0.lock(), 0);
    }

    #[tokio::test]
    async fn an_upload_of_unknown_length_reserves_as_it_comes_and_owes_nothing_for_what_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let reserved = Reserved::default();
        let upload = reserved.begin(&store, &HeaderMap::new(), u64::MAX, 0).unwrap();
        assert_eq!(*reserved.0.lock(), STEP);
        let chunk = Bytes::from(vec![0; 5 << 20]);
        let chunks = stream::iter([chunk.clone(), chunk].map(Ok::<_, std::io::Error>));
        let mut content = Box::pin(upload.fill(chunks));
        assert!(content.next().await.unwrap().is_ok());
        assert_eq!(*reserved.0.lock(), 3 << 20);
        assert!(content.next().await.unwrap().is_ok());
        assert_eq!(*reserved.0.lock(), 6 << 20);
        drop(content);
        assert_eq!(*reserved.0.lock(), 0);
    }
}
