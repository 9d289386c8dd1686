//! Artefacts: files named by the BLAKE3 hash of their content, so that storing the same bytes twice is storing them
//! once, and so that a name can never come to mean other bytes.

use std::path::{Path, PathBuf};

use bytes::Bytes;
use forelight_protocol::{ArtifactHash, ArtifactStored, Timestamp};
use futures::stream::BoxStream;
use futures::{Stream, StreamExt as _, TryStreamExt as _};
use object_store::local::LocalFileSystem;
use object_store::{ObjectStoreExt as _, WriteMultipart};
use sqlx::SqlitePool;
use uuid::Uuid;

use crate::StoreError;

/// Bytes per write to disk.
const CHUNK: usize = 1 << 20;

/// Writes under way per upload: bounds what an upload holds in memory.
const WRITES_UNDER_WAY: usize = 4;

/// The files of one data folder.
pub struct Artifacts {
    files: LocalFileSystem,
    rows: SqlitePool,
}

/// Bytes that have come in whole and been hashed, but that nobody has asked to keep yet. Dropped, they are deleted: a
/// request that fails, or whose client goes away, leaves nothing behind.
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
    /// Where the bytes lie on the local disk, for code that reads files.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        if !self.kept
            && let Err(error) = std::fs::remove_file(&self.path)
        {
            tracing::warn!(path = %self.path.display(), %error, "an upload that nobody keeps could not be deleted");
        }
    }
}

/// An artefact's content.
pub struct ArtifactReader {
    /// Length in bytes.
    pub size: u64,
    /// The bytes.
    pub stream: BoxStream<'static, Result<Bytes, StoreError>>,
}

impl Artifacts {
    pub(crate) fn open(folder: &Path, rows: SqlitePool) -> Result<Self, StoreError> {
        std::fs::create_dir_all(folder).map_err(|error| StoreError::file(folder, error))?;
        let files = LocalFileSystem::new_with_prefix(folder)?.with_fsync(true);
        Ok(Self { files, rows })
    }

    /// Takes in a stream of at most `limit` bytes and hashes it on the way. Nothing is left behind if the stream
    /// fails, is too long, or is dropped half-way.
    pub async fn stage<E: std::fmt::Display>(
        &self,
        content: impl Stream<Item = Result<Bytes, E>>,
        limit: u64,
    ) -> Result<Staged, StoreError> {
        let location = object_store::path::Path::from(format!("staging/{}.zip", Uuid::now_v7().simple()));
        let upload = self.files.put_multipart(&location).await?;
        let mut writer = WriteMultipart::new_with_chunk_size(upload, CHUNK);
        let mut hasher = blake3::Hasher::new();
        let mut size = 0u64;
        let mut content = std::pin::pin!(content);
        let outcome = loop {
            match content.next().await {
                None => break Ok(()),
                Some(Err(error)) => break Err(StoreError::BrokenOff(error.to_string())),
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
                tracing::warn!(%location, error = %leftover, "an upload that was cut off could not be cleared away");
            }
            return Err(error);
        }
        writer.finish().await?;
        let path = self.files.path_to_filesystem(&location)?;
        Ok(Staged { location, path, kept: false, hash: ArtifactHash(*hasher.finalize().as_bytes()), size })
    }

    /// Keeps staged bytes. When this returns the file and its row are on disk.
    pub async fn keep(&self, mut staged: Staged, now: Timestamp) -> Result<ArtifactStored, StoreError> {
        let (hash, size) = (staged.hash, staged.size);
        // The file first, then the row: a row without a file would promise what is not there, a file without a
        // row is only waste, and is overwritten by the same bytes when they come again.
        self.files.rename(&staged.location, &place(hash)).await?;
        staged.kept = true;
        let inserted = sqlx::query(
            "INSERT INTO artifacts (hash, size, created_at) VALUES (?, ?, ?) ON CONFLICT DO NOTHING",
        )
        .bind(&hash.0[..])
        .bind(i64::try_from(size).unwrap_or(i64::MAX))
        .bind(now.micros())
        .execute(&self.rows)
        .await?;
        Ok(ArtifactStored { hash, size, existed: inserted.rows_affected() == 0 })
    }

    /// Stages and keeps a stream that was announced under a hash; other bytes are refused and thrown away.
    pub async fn put<E: std::fmt::Display>(
        &self,
        expected: ArtifactHash,
        content: impl Stream<Item = Result<Bytes, E>>,
        limit: u64,
        now: Timestamp,
    ) -> Result<ArtifactStored, StoreError> {
        let staged = self.stage(content, limit).await?;
        if staged.hash != expected {
            return Err(StoreError::HashMismatch { expected, actual: staged.hash });
        }
        self.keep(staged, now).await
    }

    /// The artefact's length in bytes.
    pub async fn size(&self, hash: ArtifactHash) -> Result<u64, StoreError> {
        let size: Option<i64> = sqlx::query_scalar("SELECT size FROM artifacts WHERE hash = ?")
            .bind(&hash.0[..])
            .fetch_optional(&self.rows)
            .await?;
        size.and_then(|size| u64::try_from(size).ok()).ok_or(StoreError::NotFound("artefact"))
    }

    /// The artefact's content.
    pub async fn get(&self, hash: ArtifactHash) -> Result<ArtifactReader, StoreError> {
        let size = self.size(hash).await?;
        let object = match self.files.get(&place(hash)).await {
            Ok(object) if object.meta.size == size => object,
            Ok(_) => {
                return Err(StoreError::Corrupt(format!(
                    "artefact {hash} does not have its length of {size} bytes"
                )));
            }
            Err(object_store::Error::NotFound { .. }) => {
                return Err(StoreError::Corrupt(format!("artefact {hash} has a row but no file")));
            }
            Err(error) => return Err(error.into()),
        };
        Ok(ArtifactReader { size, stream: object.into_stream().map_err(StoreError::from).boxed() })
    }

    /// Deletes what uploads left behind that were under way when the last process died.
    pub(crate) async fn discard_unfinished(&self) -> Result<(), StoreError> {
        let folder = self.files.path_to_filesystem(&object_store::path::Path::from("staging"))?;
        match tokio::fs::remove_dir_all(&folder).await {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(StoreError::file(&folder, error)),
        }
    }
}

/// `blake3/ab/abcd…`: 256 folders keep each of them short.
fn place(hash: ArtifactHash) -> object_store::path::Path {
    let name = hash.to_string();
    object_store::path::Path::from(format!("blake3/{}/{name}", &name[..2]))
}
