//! The errors of the store.

use forelight_protocol::ArtifactHash;

/// The result of a call to the store.
pub(crate) type Result<T, E = StoreError> = std::result::Result<T, E>;

/// Why a call failed. Nothing was changed, unless the variant says otherwise.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// There is no such thing.
    #[error("there is no such {0}")]
    NotFound(&'static str),
    /// The caller does not hold the lease, or holds it no longer. Recorded as an event.
    #[error("the lease has ended or its task was handed to another worker; drop the task")]
    LeaseLost,
    /// The project does not exist.
    #[error(
        "there is no project {0:?}; ask an operator to make it with `forelight project`, or name another"
    )]
    NoProject(String),
    /// A project or a token has used up its quota.
    #[error("{0}")]
    QuotaExceeded(String),
    /// The state of the thing does not allow this.
    #[error("{0}")]
    Conflict(String),
    /// A one-time token is unknown or has expired.
    #[error("{0}")]
    JoinRefused(String),
    /// A result names an artefact that was never stored.
    #[error("artefact {0} is not stored; store it before a result names it")]
    MissingArtifact(ArtifactHash),
    /// What a worker says is not possible. If it is a result, its lease has failed, and its task is ready
    /// again.
    #[error("{reason}: this is not possible, so it is refused")]
    Implausible {
        /// JSON pointer to the field.
        pointer: String,
        /// Why.
        reason: String,
    },
    /// The idempotency key was used for another request.
    #[error("the idempotency key was used for another request")]
    KeyReused,
    /// The received content does not have the announced hash.
    #[error("the content has the hash {actual}, not {expected}")]
    HashMismatch {
        /// The announced hash.
        expected: ArtifactHash,
        /// The hash of the received content.
        actual: ArtifactHash,
    },
    /// More bytes than allowed.
    #[error("the content is longer than the limit of {limit} bytes")]
    TooLarge {
        /// The limit, in bytes.
        limit: u64,
    },
    /// The upload ended too early.
    #[error("the upload ended too early: {0}")]
    BrokenOff(String),
    /// The database is locked, or all its connections are in use. Try again.
    #[error("the database is busy")]
    Busy,
    /// The disk is full.
    #[error("the disk is full")]
    Full,
    /// Another service has this data folder open.
    #[error("another service uses the data folder {0}")]
    InUse(String),
    /// The content of a kept artefact is missing or has changed.
    #[error("the farm no longer has the content of artefact {hash}: {reason}")]
    ArtifactLost {
        /// The artefact.
        hash: ArtifactHash,
        /// What was found instead.
        reason: String,
    },
    /// The content of a kept artefact is not what its name says.
    #[error("the content of artefact {hash} has changed on the farm's disk or in its bucket")]
    ArtifactDamaged {
        /// The artefact.
        hash: ArtifactHash,
    },
    /// The database contains invalid data.
    #[error("the database is damaged: {0}")]
    Corrupt(String),
    /// The database that a service should open is damaged. Nothing was written to it.
    #[error("the database {path} is damaged: {reason}")]
    Damaged {
        /// Its file.
        path: String,
        /// The damage.
        reason: String,
    },
    /// The database failed.
    #[error("the database failed: {0}")]
    Database(#[source] sqlx::Error),
    /// The schema could not be brought up to date.
    #[error("the database could not be brought up to date: {0}")]
    Migration(#[from] sqlx::migrate::MigrateError),
    /// The artefact store failed.
    #[error("the artefact store failed: {0}")]
    Artifacts(#[source] object_store::Error),
    /// The remote artefact store is not available. Try again.
    #[error("the artefact store is not available: {0}")]
    ArtifactsAway(#[source] object_store::Error),
    /// The configured place for artefacts cannot be used.
    #[error("artefacts cannot be kept in {0}")]
    ArtifactPlace(String),
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    File {
        /// Which file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
}

impl StoreError {
    pub(crate) fn file(path: &std::path::Path, source: std::io::Error) -> Self {
        if source.kind() == std::io::ErrorKind::StorageFull {
            return StoreError::Full;
        }
        StoreError::File { path: path.display().to_string(), source }
    }
}

/// SQLite's primary result codes that callers tell apart.
const SQLITE_BUSY: i32 = 5;
const SQLITE_LOCKED: i32 = 6;
const SQLITE_CORRUPT: i32 = 11;
const SQLITE_FULL: i32 = 13;
const SQLITE_NOTADB: i32 = 26;

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        if matches!(error, sqlx::Error::PoolTimedOut) {
            return StoreError::Busy;
        }
        let code = error
            .as_database_error()
            .and_then(|error| error.code())
            .and_then(|code| code.parse::<i32>().ok())
            .map(|extended| extended & 0xff);
        match code {
            Some(SQLITE_BUSY | SQLITE_LOCKED) => StoreError::Busy,
            Some(SQLITE_FULL) => StoreError::Full,
            Some(SQLITE_CORRUPT | SQLITE_NOTADB) => StoreError::Corrupt(error.to_string()),
            _ => StoreError::Database(error),
        }
    }
}

impl From<object_store::Error> for StoreError {
    fn from(error: object_store::Error) -> Self {
        let mut source: Option<&(dyn std::error::Error + 'static)> = Some(&error);
        while let Some(cause) = source {
            if let Some(io) = cause.downcast_ref::<std::io::Error>()
                && io.kind() == std::io::ErrorKind::StorageFull
            {
                return StoreError::Full;
            }
            source = cause.source();
        }
        StoreError::Artifacts(error)
    }
}

impl From<serde_json::Error> for StoreError {
    fn from(error: serde_json::Error) -> Self {
        StoreError::Corrupt(error.to_string())
    }
}
