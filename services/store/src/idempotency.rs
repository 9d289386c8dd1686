//! Requests that may be sent twice.
//!
//! The hazard: a client sends a job, the answer is lost, it sends the job again, and the farm renders it twice. A
//! client that can repeat a request names it with an idempotency key, and the answer is recorded *in the transaction
//! that creates*. Then either both are on disk or neither, and a repetition, at any later time and after any crash,
//! finds the first answer. There is no state "in flight" here that a crash could leave behind.

use serde::Serialize;
use sqlx::SqliteConnection;

use forelight_protocol::Timestamp;

use crate::columns::Json;
use crate::database::Store;
use crate::database::Write;
use crate::error::StoreError;
use crate::writing::later;

/// For how long an answer is remembered: a day, in microseconds.
const REMEMBERED: i64 = 24 * 3_600_000_000;

/// A client's name for one of its requests.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct IdempotencyKey {
    /// Hash of the client's token: keys of different clients have nothing to do with each other.
    pub principal: [u8; 32],
    /// The key, 1 to 255 characters.
    pub key: String,
    /// Hash of method, address and body.
    pub request_hash: [u8; 32],
}

/// An answer given earlier.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RecordedAnswer {
    /// HTTP status.
    pub status: u16,
    /// JSON body.
    pub body: String,
}

/// Either something was created now, or the request had been answered before.
#[derive(Clone, PartialEq, Debug)]
pub enum Answered<T> {
    /// Created now.
    Fresh(T),
    /// This was the answer then.
    Repeated(RecordedAnswer),
}

impl Store {
    /// What was answered to this request, if it was. [`StoreError::KeyReused`] if the key stands for another one.
    pub async fn recorded_answer(&self, key: &IdempotencyKey) -> Result<Option<RecordedAnswer>, StoreError> {
        let mut connection = self.readers().acquire().await?;
        lookup(&mut connection, key).await
    }
}

async fn lookup(
    connection: &mut SqliteConnection,
    key: &IdempotencyKey,
) -> Result<Option<RecordedAnswer>, StoreError> {
    let row = sqlx::query!(
        "SELECT request_hash, status, body FROM idempotency WHERE principal = ? AND key = ?",
        &key.principal[..],
        &key.key
    )
    .fetch_optional(connection)
    .await?;
    let Some(row) = row else { return Ok(None) };
    if row.request_hash != key.request_hash {
        return Err(StoreError::KeyReused);
    }
    Ok(Some(RecordedAnswer { status: row.status, body: row.body }))
}

/// As [`Store::recorded_answer`], inside a write; nothing without a key.
pub(crate) async fn earlier_answer(
    write: &mut Write,
    key: Option<&IdempotencyKey>,
) -> Result<Option<RecordedAnswer>, StoreError> {
    match key {
        Some(key) => lookup(write.connection().await?, key).await,
        None => Ok(None),
    }
}

/// Records the answer inside the write that creates; nothing without a key.
pub(crate) fn record(
    write: &mut Write,
    key: Option<&IdempotencyKey>,
    status: u16,
    body: &impl Serialize,
    now: Timestamp,
) -> Result<(), StoreError> {
    let Some(key) = key else { return Ok(()) };
    later!(
        write,
        "INSERT INTO idempotency (principal, key, request_hash, status, body, created_at) \
         VALUES (?, ?, ?, ?, ?, ?)",
        &key.principal[..],
        &key.key,
        &key.request_hash[..],
        status,
        Json(body),
        now.micros()
    );
    Ok(())
}

/// Forgets answers of more than a day ago.
pub(crate) async fn forget_old(write: &mut Write, now: Timestamp) -> Result<(), StoreError> {
    sqlx::query!("DELETE FROM idempotency WHERE created_at < ?", now.plus_micros(-REMEMBERED).micros())
        .execute(write.connection().await?)
        .await?;
    Ok(())
}
