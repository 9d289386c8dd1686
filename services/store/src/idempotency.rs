//! Requests that may be sent twice.
//!
//! The hazard: a client submits a job, the answer is lost, the client submits again, and the farm renders the
//! job twice. A client that may repeat a request names it with an idempotency key. The answer is recorded *in
//! the transaction that creates*: either both are on disk, or neither. So a repetition finds the first
//! answer, at any later time and after any crash. There is no state "in flight" that a crash could leave
//! behind.

use serde::Serialize;
use sqlx::SqliteConnection;

use forelight_protocol::Timestamp;

use crate::columns::Json;
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::writing::{later, run};

/// How long an answer is kept: a day, in microseconds.
const REMEMBERED: i64 = 24 * 3_600_000_000;

/// A client's name for one of its requests.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct IdempotencyKey {
    /// Hash of the client's token: clients do not share keys.
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

/// The answer to a request that may be a repetition.
#[derive(Clone, PartialEq, Debug)]
pub enum Answered<T> {
    /// The request was carried out now.
    Fresh(T),
    /// The request was answered before, with this.
    Repeated(RecordedAnswer),
}

impl Store {
    /// The earlier answer to this request. [`StoreError::KeyReused`] if the key was used for another request.
    pub async fn recorded_answer(&self, key: &IdempotencyKey) -> Result<Option<RecordedAnswer>> {
        lookup(&mut *self.readers().acquire().await?, key).await
    }
}

async fn lookup(connection: &mut SqliteConnection, key: &IdempotencyKey) -> Result<Option<RecordedAnswer>> {
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

/// As [`Store::recorded_answer`], inside a write. `None` without a key.
pub(crate) async fn earlier_answer(
    write: &mut Write,
    key: Option<&IdempotencyKey>,
) -> Result<Option<RecordedAnswer>> {
    match key {
        Some(key) => lookup(write.connection().await?, key).await,
        None => Ok(None),
    }
}

/// Records the answer inside the write that creates. Does nothing without a key.
pub(crate) fn record(
    write: &mut Write,
    key: Option<&IdempotencyKey>,
    status: u16,
    body: &impl Serialize,
    now: Timestamp,
) {
    let Some(key) = key else { return };
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
}

pub(crate) async fn forget_old(write: &mut Write, now: Timestamp) -> Result<()> {
    run!(write, "DELETE FROM idempotency WHERE created_at < ?", now.plus_micros(-REMEMBERED).micros());
    Ok(())
}
