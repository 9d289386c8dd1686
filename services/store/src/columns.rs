//! Types of columns. `sqlx.toml` assigns them to columns, and `query!` and its relatives decode rows into
//! them.

use std::marker::PhantomData;

use forelight_protocol::words::by_name;
use forelight_protocol::{
    ArtifactHash, BookingId, BudgetForecast, BundleId, DeliveryId, JobId, JobState, LeaseId, LogLevel,
    NodeId, PlanId, SceneSummary, SessionId, TaskId, TaskKind, TaskSpec, Timestamp, TokenId, WebhookId,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::encode::IsNull;
use sqlx::error::BoxDynError;
use sqlx::sqlite::{SqliteArgumentsBuffer, SqliteTypeInfo, SqliteValueRef};
use sqlx::{Decode, Encode, Sqlite, Type};
use uuid::Uuid;

use crate::error::{Result, StoreError};
use crate::leases::state::LeaseState;

/// The error for a column value that this program never writes.
pub(crate) fn corrupt(column: &str, reason: impl std::fmt::Display) -> StoreError {
    StoreError::Corrupt(format!("column {column}: {reason}"))
}

macro_rules! text {
    ($($name:ident),*) => {
        $(impl<T> Type<Sqlite> for $name<T> {
            fn type_info() -> SqliteTypeInfo {
                <str as Type<Sqlite>>::type_info()
            }
        })*
    };
}
text!(Json, Unread, Word);

/// A wire type as JSON.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Json<T>(pub T);

impl<'r, T: DeserializeOwned> Decode<'r, Sqlite> for Json<T> {
    fn decode(value: SqliteValueRef<'r>) -> Result<Self, BoxDynError> {
        let text = <&str as Decode<Sqlite>>::decode(value)?;
        serde_json::from_str(text).map(Self).map_err(|error| named::<T>(error))
    }
}

impl<'q, T: Serialize> Encode<'q, Sqlite> for Json<T> {
    fn encode_by_ref(&self, buffer: &mut SqliteArgumentsBuffer) -> Result<IsNull, BoxDynError> {
        Encode::<Sqlite>::encode(serde_json::to_string(&self.0)?, buffer)
    }
}

/// A long JSON value that is parsed only where it is needed.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Unread<T> {
    text: String,
    wire_type: PhantomData<T>,
}

impl<T: DeserializeOwned> Unread<T> {
    pub fn read(self) -> Result<T> {
        serde_json::from_str(&self.text).map_err(|error| StoreError::Corrupt(named::<T>(error).to_string()))
    }
}

impl<'r, T> Decode<'r, Sqlite> for Unread<T> {
    fn decode(value: SqliteValueRef<'r>) -> Result<Self, BoxDynError> {
        Ok(Self { text: <String as Decode<Sqlite>>::decode(value)?, wire_type: PhantomData })
    }
}

/// A value of an enumeration, by its JSON name.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Word<T>(pub T);

impl<'r, T: DeserializeOwned> Decode<'r, Sqlite> for Word<T> {
    fn decode(value: SqliteValueRef<'r>) -> Result<Self, BoxDynError> {
        let text = <&str as Decode<Sqlite>>::decode(value)?;
        by_name(text).map(Self).map_err(|error| named::<T>(error))
    }
}

/// An id as a statement reads it from JSON, by `unhex`.
pub(crate) fn hex(id: Uuid) -> String {
    id.simple().to_string()
}

/// Ids as a statement reads them: `SELECT unhex(value) FROM json_each(?)`.
pub(crate) fn hex_list(ids: impl IntoIterator<Item = Uuid>) -> Json<Vec<String>> {
    Json(ids.into_iter().map(hex).collect())
}

/// A decoding error with the name of the expected type.
fn named<T>(error: impl std::fmt::Display) -> BoxDynError {
    let name = std::any::type_name::<T>();
    format!("{}: {error}", name.rsplit("::").next().unwrap_or(name)).into()
}

/// Microseconds since 1970-01-01T00:00:00Z.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, sqlx::Type)]
#[sqlx(transparent)]
pub(crate) struct Time(pub i64);

impl From<Time> for Timestamp {
    fn from(time: Time) -> Self {
        Timestamp::from_micros(time.0)
    }
}

/// An id, 16 bytes. It converts into the id of any kind of thing.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, sqlx::Type)]
#[sqlx(transparent)]
pub(crate) struct Id(pub Uuid);

macro_rules! from_id {
    ($($name:ident),*) => {
        $(impl From<Id> for $name {
            fn from(id: Id) -> Self {
                $name(id.0)
            }
        })*
    };
}
from_id!(
    BookingId, BundleId, JobId, LeaseId, NodeId, PlanId, SessionId, TaskId, TokenId, DeliveryId, WebhookId
);

macro_rules! from_column {
    ($($column:ident<$name:ty>),* $(,)?) => {
        $(impl From<$column<$name>> for $name {
            fn from(column: $column<$name>) -> Self {
                column.0
            }
        })*
    };
}
from_column!(Json<BudgetForecast>, Json<SceneSummary>, Json<TaskSpec>);
from_column!(Word<JobState>, Word<LeaseState>, Word<LogLevel>, Word<TaskKind>);

/// A BLAKE3 hash, 32 bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Hash(pub ArtifactHash);

impl Type<Sqlite> for Hash {
    fn type_info() -> SqliteTypeInfo {
        <[u8] as Type<Sqlite>>::type_info()
    }
}

impl<'r> Decode<'r, Sqlite> for Hash {
    fn decode(value: SqliteValueRef<'r>) -> Result<Self, BoxDynError> {
        let bytes = <&[u8] as Decode<Sqlite>>::decode(value)?;
        Ok(Self(ArtifactHash(bytes.try_into().map_err(|_| "a hash that is not 32 bytes long")?)))
    }
}

impl From<Hash> for ArtifactHash {
    fn from(hash: Hash) -> Self {
        hash.0
    }
}
