//! Deletes artefacts that nothing refers to.
//!
//! The hazard: a worker uploads bytes, and names them in a result a little later. In between nothing refers to
//! them. So an artefact is first marked, and deleted only a day after; an upload or a question about it takes
//! the mark away. In the write that deletes the row, the references are looked for once more.
//!
//! The other hazard: the same bytes are uploaded again between the deletion of the row and that of the file.
//! Uploads hold a lock that the hash selects, and a file is deleted only while nobody holds it.

use forelight_protocol::{ArtifactHash, Files, Timestamp};
use futures::{StreamExt as _, TryStreamExt as _};
use object_store::path::Path;
use object_store::{ObjectMeta, ObjectStore as _, ObjectStoreExt as _};
use tokio::sync::RwLock;

use super::{Artifacts, FOLDER, place_of};
use crate::error::{Result, StoreError};
use crate::policy::retention::UNUSED_KEPT;
use crate::writing::run;

/// Locks of names: a file is deleted under one of them, and written under it.
pub(super) struct Locks([RwLock<()>; 256]);

impl Default for Locks {
    fn default() -> Self {
        Self(std::array::from_fn(|_| RwLock::default()))
    }
}

impl Locks {
    pub fn of(&self, hash: ArtifactHash) -> &RwLock<()> {
        &self.0[usize::from(hash.0[0])]
    }
}

/// All hashes in slices, so that a write looks at some of them: the first of a slice, and one after its last.
fn slices() -> impl Iterator<Item = (Vec<u8>, Vec<u8>)> {
    const WIDTH: u8 = 8;
    (0..=u8::MAX).step_by(WIDTH.into()).map(|first| {
        let after = first.checked_add(WIDTH).map_or_else(|| vec![u8::MAX; 33], |next| vec![next]);
        (vec![first], after)
    })
}

impl Artifacts {
    /// Marks what nothing refers to, and deletes what was marked long ago; or only counts both. Returns what
    /// was deleted, and what waits for it.
    pub(crate) async fn collect(&self, dry_run: bool, now: Timestamp) -> Result<(Files, Files)> {
        if !dry_run {
            for slice in slices() {
                self.mark(slice, now).await?;
            }
        }
        let (mut deleted, mut waiting) = (Files::default(), Files::default());
        let cut = now.plus_micros(-UNUSED_KEPT);
        for slice in slices() {
            for (hash, size, since) in self.unused(slice).await? {
                let is_past = since.is_some_and(|since| since < cut);
                let goes = is_past && (dry_run || self.delete(hash, cut).await?);
                let files = if goes { &mut deleted } else { &mut waiting };
                files.number += 1;
                files.bytes += size;
            }
        }
        if !dry_run {
            self.delete_strays(cut).await?;
        }
        Ok((deleted, waiting))
    }

    async fn mark(&self, (from, until): (Vec<u8>, Vec<u8>), now: Timestamp) -> Result<()> {
        let mut write = self.writer.write().await?;
        run!(
            write,
            "UPDATE artifacts SET unused_since = NULL WHERE hash >= ? AND hash < ? \
             AND unused_since IS NOT NULL \
             AND EXISTS (SELECT 1 FROM used_artifacts u WHERE u.hash = artifacts.hash)",
            from,
            until
        );
        run!(
            write,
            "UPDATE artifacts SET unused_since = ? WHERE hash >= ? AND hash < ? AND unused_since IS NULL \
             AND NOT EXISTS (SELECT 1 FROM used_artifacts u WHERE u.hash = artifacts.hash)",
            now.micros(),
            from,
            until
        );
        self.writer.commit(write).await
    }

    /// Artefacts that nothing refers to, their sizes, and since when this is known.
    async fn unused(
        &self,
        (from, until): (Vec<u8>, Vec<u8>),
    ) -> Result<Vec<(ArtifactHash, u64, Option<Timestamp>)>> {
        let rows = sqlx::query!(
            "SELECT hash, size, unused_since FROM artifacts WHERE hash >= ? AND hash < ? \
             AND NOT EXISTS (SELECT 1 FROM used_artifacts u WHERE u.hash = artifacts.hash) ORDER BY hash",
            from,
            until
        )
        .fetch_all(&self.readers)
        .await?;
        let unused =
            |(hash, size, since): (_, _, Option<i64>)| (hash, size, since.map(Timestamp::from_micros));
        Ok(rows.into_iter().map(|row| unused((row.hash.0, row.size, row.unused_since))).collect())
    }

    /// Deletes an artefact that nothing has referred to since `cut`. Returns whether it did: if it is being
    /// uploaded again, or something refers to it by now, it stays.
    async fn delete(&self, hash: ArtifactHash, cut: Timestamp) -> Result<bool> {
        let Ok(_alone) = self.locks.of(hash).try_write() else { return Ok(false) };
        let mut write = self.writer.write().await?;
        let deleted = run!(
            write,
            "DELETE FROM artifacts WHERE hash = ? AND unused_since < ? \
             AND NOT EXISTS (SELECT 1 FROM used_artifacts u WHERE u.hash = artifacts.hash)",
            &hash.0[..],
            cut.micros()
        );
        self.writer.commit(write).await?;
        if deleted > 0 {
            // The row first, then the file: a file without a row is only waste, see `delete_strays`.
            self.delete_file(hash).await?;
        }
        Ok(deleted > 0)
    }

    async fn delete_file(&self, hash: ArtifactHash) -> Result<()> {
        self.verified.lock().remove(&hash);
        let gone = match &self.remote {
            Some(remote) => remote.delete(&place_of(hash)).await,
            None => self.files.delete(&place_of(hash)).await.map_err(StoreError::from),
        };
        match gone {
            Err(StoreError::Artifacts(object_store::Error::NotFound { .. })) => Ok(()),
            other => other,
        }
    }

    /// Deletes old files without a row: a process died between the two.
    async fn delete_strays(&self, cut: Timestamp) -> Result<()> {
        let folder = Path::from(FOLDER);
        let mut files = match &self.remote {
            Some(remote) => remote.list(&folder),
            None => self.files.list(Some(&folder)).map_err(StoreError::from).boxed(),
        };
        while let Some(ObjectMeta { location, last_modified, .. }) = files.try_next().await? {
            let hash = location.filename().and_then(|name| name.parse::<ArtifactHash>().ok());
            let (Some(hash), true) = (hash, last_modified.timestamp_micros() < cut.micros()) else {
                continue;
            };
            let Ok(_alone) = self.locks.of(hash).try_write() else { continue };
            if matches!(self.size(hash).await, Err(StoreError::NotFound(_))) {
                tracing::info!(%hash, "a file without a row is deleted");
                self.delete_file(hash).await?;
            }
        }
        Ok(())
    }
}
