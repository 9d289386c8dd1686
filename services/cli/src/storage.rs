//! What a job takes of the farm's storage, as text.

use forelight_protocol::StorageForecast;
use forelight_terminal::quantities::bytes;

/// One line of a quote.
pub fn stored(storage: &StorageForecast) -> String {
    let StorageForecast { file_bytes, database_bytes } = *storage;
    format!("stored     {} of files, {} of the database\n", bytes(file_bytes), bytes(database_bytes))
}
