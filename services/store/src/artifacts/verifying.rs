//! Whether artefacts are still what their names say.
//!
//! Hazard: disks return other bytes than were written to them, now and then without an error. An image would
//! be delivered as if it were whole, and a profile would change a quote. So content is verified before a byte
//! of it is given away. The scrub looks at all artefacts in turn, so that damage is found while a backup still
//! has the content. Large objects in a bucket are verified on the way, and their last bytes are held back.

use std::fs::File;
use std::io::{Read as _, Seek as _};
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;
use forelight_protocol::{ArtifactHash, Event, EventKind, Timestamp};
use futures::stream::{self, BoxStream};
use futures::{StreamExt as _, TryStreamExt as _};
use rustix::io::Errno;

use super::reader::{ArtifactReader, Content};
use super::{Artifacts, place_of};
use crate::error::{Result, StoreError};
use crate::events::{append, event};
use crate::writing::{later, run};

/// Content up to this length is read into memory, and given away from there.
const IN_MEMORY: u64 = 128 << 10;

/// The same for objects in a bucket, which would have to be fetched twice otherwise.
const FETCHED: u64 = 2 << 20;

/// A file that was verified this lately, and was not written to since, is not read whole again for a part of it.
const TRUSTED: Duration = Duration::from_secs(60);

/// Most files that are remembered as verified.
const MOST_TRUSTED: usize = 1024;

/// When a file was verified, and when it had been written.
pub(super) type Verified = (Instant, SystemTime);

impl Artifacts {
    /// The artefact's content, verified. Damage is written down, with an event if it is new.
    pub async fn get(&self, hash: ArtifactHash, now: Timestamp) -> Result<ArtifactReader> {
        let size = self.size(hash).await?;
        let opened = self.open_verified(hash, size, now).await;
        if let Err(error) = &opened {
            self.write_down(hash, error, now).await?;
        }
        opened
    }

    async fn open_verified(&self, hash: ArtifactHash, size: u64, now: Timestamp) -> Result<ArtifactReader> {
        let Some(remote) = &self.remote else { return self.open_local(hash, size).await };
        let lost = |reason: String| StoreError::ArtifactLost { hash, reason };
        let found = remote.get(&place_of(hash)).await?;
        let (found_size, content) = found.ok_or_else(|| lost("its file is missing".to_owned()))?;
        if found_size != size {
            return Err(lost(wrong_size(found_size, size)));
        }
        if size > FETCHED {
            let content = Content::Stream(self.held_back(hash, content, now));
            return Ok(ArtifactReader { size, content });
        }
        let content: Vec<Bytes> = content.try_collect().await?;
        let content = content.concat();
        match blake3::hash(&content).as_bytes() == &hash.0 {
            true => Ok(ArtifactReader { size, content: Content::Bytes(content.into()) }),
            false => Err(StoreError::ArtifactDamaged { hash }),
        }
    }

    async fn open_local(&self, hash: ArtifactHash, size: u64) -> Result<ArtifactReader> {
        let path = self.files.path_to_filesystem(&place_of(hash))?;
        let verified = self.verified.clone();
        let opened = tokio::task::spawn_blocking(move || {
            let trusted = verified.lock().get(&hash).copied();
            let (content, written) = open_file(&path, hash, size, trusted)?;
            let mut verified = verified.lock();
            if verified.len() >= MOST_TRUSTED {
                verified.clear();
            }
            if let Some(written) = written {
                verified.insert(hash, (Instant::now(), written));
            }
            Ok::<_, StoreError>(content)
        });
        let content = opened.await.map_err(|error| StoreError::BrokenOff(error.to_string()))??;
        Ok(ArtifactReader { size, content })
    }

    /// The same stream, without its last bytes and with an error if it is not what it should be.
    fn held_back(
        &self,
        hash: ArtifactHash,
        content: BoxStream<'static, Result<Bytes>>,
        now: Timestamp,
    ) -> BoxStream<'static, Result<Bytes>> {
        let state = (self.clone(), content, blake3::Hasher::new(), None::<Bytes>);
        stream::try_unfold(state, move |(own, mut content, mut hasher, mut held)| async move {
            while let Some(chunk) = content.try_next().await? {
                hasher.update(&chunk);
                if let Some(before) = held.replace(chunk) {
                    return Ok(Some((before, (own, content, hasher, held))));
                }
            }
            let Some(last) = held.take() else { return Ok(None) };
            if hasher.finalize().as_bytes() == &hash.0 {
                return Ok(Some((last, (own, content, hasher, None))));
            }
            let error = StoreError::ArtifactDamaged { hash };
            own.write_down(hash, &error, now).await?;
            Err(error)
        })
        .boxed()
    }

    /// Writes damage down, and tells of it once.
    async fn write_down(&self, hash: ArtifactHash, error: &StoreError, now: Timestamp) -> Result<()> {
        if !is_damage(error) {
            return Ok(());
        }
        let reason = error.to_string();
        let mut write = self.writer.write().await?;
        let is_new = run!(
            write,
            "INSERT INTO damaged_artifacts (hash, reason, found_at) SELECT hash, ?2, ?3 FROM artifacts \
             WHERE hash = ?1 ON CONFLICT DO NOTHING",
            &hash.0[..],
            reason,
            now.micros()
        ) > 0;
        if is_new {
            let told = Event { message: Some(reason), ..event(EventKind::ArtifactDamaged, now) };
            append(&mut write, told);
        }
        self.writer.commit(write).await
    }

    /// Whether the content was found missing or changed, and has not come back.
    pub(super) async fn is_damaged(&self, hash: ArtifactHash) -> Result<bool> {
        Ok(sqlx::query_scalar!(
            r#"SELECT EXISTS (SELECT 1 FROM damaged_artifacts WHERE hash = ?) AS "it!: bool""#,
            &hash.0[..]
        )
        .fetch_one(&self.readers)
        .await?)
    }

    /// Goes on with the farm's own scrub, which goes round and round. See [`Self::scrub`].
    pub async fn scrub_on(&self, bytes: u64, now: Timestamp) -> Result<Scrubbed> {
        let after = sqlx::query_scalar!("SELECT after FROM scrub").fetch_one(&self.readers).await?;
        let after = after.map(|hash| hash.as_slice().try_into().map(ArtifactHash)).transpose();
        let scrubbed = self.scrub(after.map_err(|_| corrupt_hash())?, bytes, now).await?;
        let (next, rounds) = (scrubbed.next.map(|hash| hash.0.to_vec()), i64::from(scrubbed.next.is_none()));
        let mut write = self.writer.write().await?;
        later!(write, "UPDATE scrub SET after = ?, rounds = rounds + ?", next, rounds);
        self.writer.commit(write).await?;
        Ok(scrubbed)
    }

    /// Looks at the artefacts after this one, in the order of their hashes, until `bytes` were read. Objects in
    /// a bucket are only asked for, because reading them costs money.
    pub async fn scrub(&self, after: Option<ArtifactHash>, bytes: u64, now: Timestamp) -> Result<Scrubbed> {
        let mut scrubbed = Scrubbed { next: after, ..Scrubbed::default() };
        loop {
            let after = scrubbed.next.map_or(Vec::new(), |hash| hash.0.to_vec());
            let next = sqlx::query!(
                r#"SELECT hash, size AS "size: u64" FROM artifacts WHERE hash > ? ORDER BY hash LIMIT 1"#,
                after
            )
            .fetch_optional(&self.readers)
            .await?;
            let Some(row) = next else {
                scrubbed.next = None;
                return Ok(scrubbed);
            };
            let hash = row.hash.0;
            match self.look_at(hash, row.size).await {
                Ok(()) => self.is_whole(hash).await?,
                Err(error) if is_damage(&error) => {
                    self.write_down(hash, &error, now).await?;
                    scrubbed.damaged.push(error.to_string());
                }
                Err(error) => return Err(error),
            }
            scrubbed.artifacts += 1;
            scrubbed.bytes += row.size;
            scrubbed.next = Some(hash);
            if scrubbed.bytes >= bytes {
                return Ok(scrubbed);
            }
        }
    }

    async fn look_at(&self, hash: ArtifactHash, size: u64) -> Result<()> {
        if let Some(remote) = &self.remote {
            return match remote.holds(&place_of(hash), size).await? {
                true => Ok(()),
                false => Err(StoreError::ArtifactLost { hash, reason: "its object is missing".to_owned() }),
            };
        }
        self.verified.lock().remove(&hash);
        self.open_local(hash, size).await.map(drop)
    }

    /// Forgets damage of content that is whole again.
    async fn is_whole(&self, hash: ArtifactHash) -> Result<()> {
        if !self.is_damaged(hash).await? {
            return Ok(());
        }
        let mut write = self.writer.write().await?;
        later!(write, "DELETE FROM damaged_artifacts WHERE hash = ?", &hash.0[..]);
        self.writer.commit(write).await
    }
}

/// What a part of a scrub found.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Scrubbed {
    /// Artefacts that were looked at.
    pub artifacts: u64,
    /// Their bytes.
    pub bytes: u64,
    /// What is missing or has changed, a line for each.
    pub damaged: Vec<String>,
    /// The last of them. `None` if there are no others: the next part begins anew.
    pub next: Option<ArtifactHash>,
}

fn is_damage(error: &StoreError) -> bool {
    matches!(error, StoreError::ArtifactLost { .. } | StoreError::ArtifactDamaged { .. })
}

fn corrupt_hash() -> StoreError {
    StoreError::Corrupt("an artefact's hash does not have 32 bytes".to_owned())
}

fn wrong_size(found: u64, size: u64) -> String {
    format!("its file has {found} bytes instead of {size}")
}

/// Opens a file and verifies it, unless it was `trusted` lately. Also returns when it had been written, if it
/// was verified now.
fn open_file(
    path: &Path,
    hash: ArtifactHash,
    size: u64,
    trusted: Option<Verified>,
) -> Result<(Content, Option<SystemTime>)> {
    let lost = |reason: String| StoreError::ArtifactLost { hash, reason };
    let failed = |error: std::io::Error| match Errno::from_io_error(&error) {
        // It is not the file's fault, and will be over.
        Some(Errno::MFILE | Errno::NFILE | Errno::NOMEM | Errno::AGAIN) | None => {
            StoreError::file(path, error)
        }
        Some(_) => lost(format!("its file cannot be read: {error}")),
    };
    let mut file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(lost("its file is missing".to_owned()));
        }
        Err(error) => return Err(failed(error)),
    };
    let known = file.metadata().map_err(failed)?;
    if known.len() != size {
        return Err(lost(wrong_size(known.len(), size)));
    }
    if size <= IN_MEMORY {
        let mut content = Vec::with_capacity(size as usize);
        file.read_to_end(&mut content).map_err(failed)?;
        return match blake3::hash(&content).as_bytes() == &hash.0 {
            true => Ok((Content::Bytes(content.into()), None)),
            false => Err(StoreError::ArtifactDamaged { hash }),
        };
    }
    let written = known.modified().map_err(failed)?;
    if trusted.is_some_and(|(at, of)| of == written && at.elapsed() < TRUSTED) {
        return Ok((Content::File(file), None));
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(&file).map_err(failed)?;
    if hasher.finalize().as_bytes() != &hash.0 {
        return Err(StoreError::ArtifactDamaged { hash });
    }
    file.rewind().map_err(failed)?;
    Ok((Content::File(file), Some(written)))
}
