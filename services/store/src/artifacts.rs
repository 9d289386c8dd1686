//! Artefacts: files named by the BLAKE3 hash of their content. The same bytes are stored once, and a name
//! never comes to mean other bytes.
//!
//! Uploads are staged in the data folder and hashed on the way. An upload gets its name only if it arrived
//! whole and has the announced hash. It is then renamed into place in the data folder, or sent to a bucket as
//! one object ([`ArtifactPlace`]). In both cases the row is written after the file is durable.

mod collecting;
mod place;
mod reader;
mod remote;
mod verifying;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use forelight_protocol::{ArtifactHash, ArtifactStored, Timestamp};
use futures::{Stream, StreamExt as _};
use object_store::local::LocalFileSystem;
use object_store::{ObjectStoreExt as _, WriteMultipart};
use parking_lot::Mutex;
use sqlx::SqlitePool;
use uuid::Uuid;

use self::collecting::Locks;
use self::remote::Remote;
use self::verifying::Verified;
use crate::error::{Result, StoreError};
use crate::writing::{Writer, ask, later, run};

pub use self::place::{ArtifactPlace, BadPlace};
pub use self::reader::ArtifactReader;
pub use self::verifying::Scrubbed;

const CHUNK: usize = 1 << 20;

/// Concurrent writes per upload: bounds the memory of an upload.
const WRITES_UNDER_WAY: usize = 4;

/// The artefacts of one farm.
#[derive(Clone)]
pub struct Artifacts {
    /// Where uploads are staged, and where artefacts are kept unless there is a `remote`.
    files: LocalFileSystem,
    /// Where artefacts are kept, if not in `files`.
    remote: Option<Remote>,
    writer: Writer,
    readers: SqlitePool,
    /// Held while a file is written or deleted.
    locks: Arc<Locks>,
    /// Files that were verified lately.
    verified: Arc<Mutex<HashMap<ArtifactHash, Verified>>>,
}

/// Bytes that were received whole and hashed, but are not kept yet. Dropping them deletes them: a request
/// that fails, or whose client disconnects, leaves nothing behind.
#[derive(Debug)]
pub struct Staged {
    location: object_store::path::Path,
    path: PathBuf,
    kept: bool,
    /// Hash of the content.
    pub hash: ArtifactHash,
    /// Length in bytes.
    pub size: u64,
}

impl Staged {
    /// Path on the local disk, for code that reads files.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        if !self.kept
            && let Err(error) = std::fs::remove_file(&self.path)
        {
            tracing::warn!(path = %self.path.display(), %error, "could not delete an unused upload");
        }
    }
}

impl Artifacts {
    pub(crate) fn open(
        folder: &Path,
        at: &ArtifactPlace,
        writer: Writer,
        readers: SqlitePool,
    ) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|error| StoreError::file(folder, error))?;
        let files = LocalFileSystem::new_with_prefix(folder)?.with_fsync(true);
        let remote = match at {
            ArtifactPlace::DataFolder => None,
            ArtifactPlace::S3 { bucket, prefix } => {
                Some(Remote::new(place::open_s3(bucket)?, prefix.as_str().into(), at.to_string()))
            }
        };
        Ok(Self { files, remote, writer, readers, locks: Arc::default(), verified: Arc::default() })
    }

    /// The same artefacts, looked up by other connections.
    pub(crate) fn read_by(&self, readers: SqlitePool) -> Self {
        Self { readers, ..self.clone() }
    }

    /// The same artefacts, kept in another object store.
    #[cfg(test)]
    pub(crate) fn resting_in(&self, objects: Arc<dyn object_store::ObjectStore>) -> Self {
        let remote = Remote::new(objects, "shots/2026".into(), "a test".to_owned());
        Self { remote: Some(remote), ..self.clone() }
    }

    /// Checks that the place where artefacts are kept can be used, as far as it answers.
    pub(crate) async fn probe(&self) -> Result<()> {
        match &self.remote {
            None => Ok(()),
            Some(remote) => remote.probe().await,
        }
    }

    /// Receives a stream of at most `limit` bytes and hashes it on the way. Nothing is left behind if the
    /// stream fails, is too long, or is dropped half-way.
    pub async fn stage(&self, content: impl Stream<Item = Result<Bytes>>, limit: u64) -> Result<Staged> {
        let location = object_store::path::Path::from(format!("staging/{}.zip", Uuid::now_v7().simple()));
        let upload = self.files.put_multipart(&location).await?;
        let mut writer = WriteMultipart::new_with_chunk_size(upload, CHUNK);
        let mut hasher = blake3::Hasher::new();
        let mut size = 0u64;
        let mut content = std::pin::pin!(content);
        let outcome = loop {
            match content.next().await {
                None => break Ok(()),
                Some(Err(error)) => break Err(error),
                Some(Ok(bytes)) => {
                    size += bytes.len() as u64;
                    if size > limit {
                        break Err(StoreError::TooLarge { limit });
                    }
                    hasher.update(&bytes);
                    if let Err(error) = writer.wait_for_capacity(WRITES_UNDER_WAY).await {
                        break Err(error.into());
                    }
                    writer.put(bytes);
                }
            }
        };
        if let Err(error) = outcome {
            if let Err(leftover) = writer.abort().await {
                tracing::warn!(%location, error = %leftover, "could not delete an upload that was cut off");
            }
            return Err(error);
        }
        writer.finish().await?;
        let path = self.files.path_to_filesystem(&location)?;
        Ok(Staged { location, path, kept: false, hash: ArtifactHash(*hasher.finalize().as_bytes()), size })
    }

    /// Keeps staged bytes. On return, the file is durable where artefacts are kept, and its row is on disk.
    pub async fn keep(&self, mut staged: Staged, now: Timestamp) -> Result<ArtifactStored> {
        let (hash, size) = (staged.hash, staged.size);
        let locks = self.locks.clone();
        let _written = locks.of(hash).read().await;
        // The file first, then the row. A row without a file would promise missing bytes. A file without a
        // row is only waste, and the same bytes overwrite it later.
        let Some(remote) = &self.remote else {
            self.files.rename(&staged.location, &place_of(hash)).await?;
            staged.kept = true;
            return self.remember(hash, size, now).await;
        };
        let known = matches!(self.size(hash).await, Ok(known) if known == size);
        if known && !self.is_damaged(hash).await? && remote.holds(&place_of(hash), size).await? {
            return self.remember(hash, size, now).await;
        }
        // In a task of its own, so that a client that disconnects leaves no parts of half an upload behind.
        let (own, remote) = (self.clone(), remote.clone());
        let kept = tokio::spawn(async move {
            let locks = own.locks.clone();
            let _written = locks.of(hash).read().await;
            remote.upload(&staged.path, &place_of(hash)).await?;
            own.remember(hash, size, now).await
        });
        kept.await.unwrap_or_else(|error| Err(StoreError::BrokenOff(error.to_string())))
    }

    async fn remember(&self, hash: ArtifactHash, size: u64, now: Timestamp) -> Result<ArtifactStored> {
        let mut write = self.writer.write().await?;
        later!(
            write,
            "UPDATE artifacts SET unused_since = NULL WHERE hash = ? AND unused_since IS NOT NULL",
            &hash.0[..]
        );
        // What was damaged is whole again.
        later!(write, "DELETE FROM damaged_artifacts WHERE hash = ?", &hash.0[..]);
        let inserted: Option<(i64,)> = ask!(
            write,
            "INSERT INTO artifacts (hash, size, created_at) VALUES (?, ?, ?) ON CONFLICT DO NOTHING \
             RETURNING size",
            &hash.0[..],
            i64::try_from(size).unwrap_or(i64::MAX),
            now.micros()
        )
        .first_row()
        .await?;
        self.writer.commit(write).await?;
        Ok(ArtifactStored { hash, size, existed: inserted.is_none() })
    }

    /// Stages and keeps a stream that was announced under a hash. Other bytes are refused and deleted.
    pub async fn put(
        &self,
        expected: ArtifactHash,
        content: impl Stream<Item = Result<Bytes>>,
        limit: u64,
        now: Timestamp,
    ) -> Result<ArtifactStored> {
        let staged = self.stage(content, limit).await?;
        if staged.hash != expected {
            return Err(StoreError::HashMismatch { expected, actual: staged.hash });
        }
        self.keep(staged, now).await
    }

    /// The artefact's length in bytes.
    pub async fn size(&self, hash: ArtifactHash) -> Result<u64> {
        sqlx::query_scalar!("SELECT size FROM artifacts WHERE hash = ?", &hash.0[..])
            .fetch_optional(&self.readers)
            .await?
            .ok_or(StoreError::NotFound("artefact"))
    }

    /// The artefact's length in bytes, for a caller that is about to name it: it is not deleted soon.
    pub async fn announce(&self, hash: ArtifactHash) -> Result<u64> {
        let row = sqlx::query!("SELECT size, unused_since FROM artifacts WHERE hash = ?", &hash.0[..])
            .fetch_optional(&self.readers)
            .await?
            .ok_or(StoreError::NotFound("artefact"))?;
        if row.unused_since.is_some() {
            let mut write = self.writer.write().await?;
            run!(write, "UPDATE artifacts SET unused_since = NULL WHERE hash = ?", &hash.0[..]);
            self.writer.commit(write).await?;
            // It may have been deleted meanwhile.
            return self.size(hash).await;
        }
        Ok(row.size)
    }

    /// Deletes uploads that were unfinished when the last process died.
    pub(crate) async fn discard_unfinished(&self) -> Result<()> {
        let folder = self.files.path_to_filesystem(&object_store::path::Path::from("staging"))?;
        match tokio::fs::remove_dir_all(&folder).await {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(StoreError::file(&folder, error)),
        }
    }
}

/// Folder of all artefacts.
const FOLDER: &str = "blake3";

/// `blake3/ab/abcd…`: with 256 folders, each stays small.
fn place_of(hash: ArtifactHash) -> object_store::path::Path {
    let name = hash.to_string();
    object_store::path::Path::from(format!("{FOLDER}/{}/{name}", &name[..2]))
}
