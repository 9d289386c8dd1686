//! From rows to values.

use forelight_protocol::{ArtifactHash, Timestamp};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::Row as _;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

use crate::error::StoreError;

/// A column holds something that was never written there by this program.
pub(crate) fn corrupt(column: &str, reason: impl std::fmt::Display) -> StoreError {
    StoreError::Corrupt(format!("column {column}: {reason}"))
}

/// The wire type in a JSON column.
pub(crate) fn json<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> Result<T, StoreError> {
    let text: &str = row.try_get(column)?;
    serde_json::from_str(text).map_err(|error| corrupt(column, error))
}

/// The wire type in a JSON column that may be NULL.
pub(crate) fn json_opt<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> Result<Option<T>, StoreError> {
    let text: Option<&str> = row.try_get(column)?;
    text.map(|text| serde_json::from_str(text).map_err(|error| corrupt(column, error))).transpose()
}

/// A wire type as the text of a JSON column.
pub(crate) fn to_json<T: Serialize>(value: &T) -> Result<String, StoreError> {
    Ok(serde_json::to_string(value)?)
}

/// The wire type whose JSON is this word: the enumerations.
pub(crate) fn word<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> Result<T, StoreError> {
    let text: &str = row.try_get(column)?;
    serde_json::from_value(serde_json::Value::from(text)).map_err(|error| corrupt(column, error))
}

/// An id column.
pub(crate) fn id(row: &SqliteRow, column: &str) -> Result<Uuid, StoreError> {
    Ok(row.try_get(column)?)
}

/// An id column that may be NULL.
pub(crate) fn id_opt(row: &SqliteRow, column: &str) -> Result<Option<Uuid>, StoreError> {
    Ok(row.try_get(column)?)
}

/// A column of microseconds.
pub(crate) fn time(row: &SqliteRow, column: &str) -> Result<Timestamp, StoreError> {
    Ok(Timestamp::from_micros(row.try_get(column)?))
}

/// A column of microseconds that may be NULL.
pub(crate) fn time_opt(row: &SqliteRow, column: &str) -> Result<Option<Timestamp>, StoreError> {
    Ok(row.try_get::<Option<i64>, _>(column)?.map(Timestamp::from_micros))
}

/// A column of whole numbers of some unsigned or narrow type.
pub(crate) fn whole<T: TryFrom<i64>>(row: &SqliteRow, column: &str) -> Result<T, StoreError> {
    let number: i64 = row.try_get(column)?;
    T::try_from(number).map_err(|_| corrupt(column, number))
}

/// As [`whole`], of a column that may be NULL.
pub(crate) fn whole_opt<T: TryFrom<i64>>(row: &SqliteRow, column: &str) -> Result<Option<T>, StoreError> {
    let number: Option<i64> = row.try_get(column)?;
    number.map(|number| T::try_from(number).map_err(|_| corrupt(column, number))).transpose()
}

/// A hash column.
pub(crate) fn hash(row: &SqliteRow, column: &str) -> Result<ArtifactHash, StoreError> {
    hash_opt(row, column)?.ok_or_else(|| corrupt(column, "NULL"))
}

/// A hash column that may be NULL.
pub(crate) fn hash_opt(row: &SqliteRow, column: &str) -> Result<Option<ArtifactHash>, StoreError> {
    let bytes: Option<&[u8]> = row.try_get(column)?;
    bytes
        .map(|bytes| bytes.try_into().map(ArtifactHash).map_err(|_| corrupt(column, "not 32 bytes")))
        .transpose()
}
