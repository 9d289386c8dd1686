//! A copy of the database that can be trusted, made while the service runs.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use sqlx::Connection as _;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

use crate::database::{DATABASE, find_damage, restrict_to_owner};
use crate::error::StoreError;

/// What a backup holds.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Backup {
    /// Length of the file in bytes.
    pub bytes: u64,
    /// Jobs in it.
    pub jobs: u64,
    /// Artefacts that it speaks of, which lie in files of their own.
    pub artifacts: u64,
    /// Bytes of these artefacts.
    pub artifact_bytes: u64,
}

/// Copies the database in the data folder to a file that is not there yet, as it is at one instant, and checks the copy from its first
/// page to its last. The service may be running and is not held up: SQLite copies what one read transaction sees. At `to` there is
/// either the whole copy, checked and flushed, or nothing.
pub async fn backup(data: &Path, to: &Path) -> Result<Backup, StoreError> {
    let source = data.join(DATABASE);
    if !source.is_file() {
        return Err(StoreError::NotFound("database in this folder"));
    }
    if to.exists() {
        return Err(StoreError::Conflict(format!("{} is there already", to.display())));
    }
    let unfinished = Unfinished(beside(to));
    let file = unfinished
        .0
        .to_str()
        .ok_or_else(|| StoreError::Conflict(format!("{}: the name of a backup is UTF-8", to.display())))?;
    // A read transaction of its own: what is committed meanwhile is not in it, what was before is, whole.
    let mut connection = open(&source, false).await?;
    sqlx::query!("VACUUM INTO ?", file).execute(&mut connection).await?;
    connection.close().await?;
    restrict_to_owner(&unfinished.0)?;
    let backup = check(&unfinished.0).await?;
    let flush = |path: &Path| {
        std::fs::File::open(path)
            .and_then(|file| file.sync_all())
            .map_err(|error| StoreError::file(path, error))
    };
    flush(&unfinished.0)?;
    std::fs::rename(&unfinished.0, to).map_err(|error| StoreError::file(to, error))?;
    flush(to.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")))?;
    Ok(backup)
}

/// Whether a file is a whole database of a farm, and what is in it.
async fn check(path: &Path) -> Result<Backup, StoreError> {
    let mut connection = open(path, true).await?;
    find_damage(&mut connection, "integrity_check").await?;
    let row = sqlx::query!(
        r#"SELECT (SELECT count(*) FROM jobs) AS "jobs!: u64", count(*) AS "artifacts!: u64",
              coalesce(sum(size), 0) AS "bytes!: u64" FROM artifacts"#
    )
    .fetch_one(&mut connection)
    .await?;
    let found = Backup {
        bytes: std::fs::metadata(path).map_err(|error| StoreError::file(path, error))?.len(),
        jobs: row.jobs,
        artifacts: row.artifacts,
        artifact_bytes: row.bytes,
    };
    connection.close().await?;
    Ok(found)
}

async fn open(path: &Path, immutable: bool) -> Result<SqliteConnection, StoreError> {
    let options = SqliteConnectOptions::from_str("sqlite:")?
        .filename(path)
        .read_only(true)
        .immutable(immutable)
        .busy_timeout(std::time::Duration::from_secs(5));
    Ok(SqliteConnection::connect_with(&options).await?)
}

/// A name in the same folder, so that the last step is a rename.
fn beside(to: &Path) -> PathBuf {
    let mut name = std::ffi::OsString::from(".");
    name.push(to.file_name().unwrap_or_default());
    name.push(format!(".{}", uuid::Uuid::now_v7().simple()));
    to.with_file_name(name)
}

/// Goes away with whatever was written so far, unless it was renamed.
struct Unfinished(PathBuf);

impl Drop for Unfinished {
    fn drop(&mut self) {
        // It is not there if it was renamed, or never begun.
        let _ = std::fs::remove_file(&self.0);
    }
}
