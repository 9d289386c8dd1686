//! Verified copies of the database, made while the service runs.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use sqlx::Connection as _;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

use crate::database::{DATABASE, find_damage, restrict_to_owner};
use crate::error::{Result, StoreError};

/// The content of a backup.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Backup {
    /// Length of the file in bytes.
    pub bytes: u64,
    /// Jobs in it.
    pub jobs: u64,
    /// Artefacts that it refers to. Their files are not part of the backup.
    pub artifacts: u64,
    /// Bytes of these artefacts.
    pub artifact_bytes: u64,
}

/// Copies the database in the data folder to a new file, as it is at one instant, and checks every page of
/// the copy. The service may be running and is not held up: SQLite copies the state of one read transaction.
/// On return, `to` is the whole copy, checked and flushed; after an error it does not exist.
pub async fn backup(data: &Path, to: &Path) -> Result<Backup> {
    let source = data.join(DATABASE);
    if !source.is_file() {
        return Err(StoreError::NotFound("database in this folder"));
    }
    if to.exists() {
        return Err(StoreError::Conflict(format!("{} already exists", to.display())));
    }
    let unfinished = Unfinished(beside(to));
    let file = unfinished.0.to_str().ok_or_else(|| {
        StoreError::Conflict(format!("{}: the name of a backup must be UTF-8", to.display()))
    })?;
    // SQLite takes an empty file, and gives its journal the same permissions.
    std::fs::write(&unfinished.0, []).map_err(|error| StoreError::file(&unfinished.0, error))?;
    restrict_to_owner(&unfinished.0)?;
    // One read transaction: it sees every earlier commit whole, and no later one.
    let mut connection = open(&source, false).await?;
    sqlx::query!("VACUUM INTO ?", file).execute(&mut connection).await?;
    connection.close().await?;
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

/// Checks that a file is an intact database of a farm, and counts its content.
async fn check(path: &Path) -> Result<Backup> {
    let (mut connection, mut other) = (open(path, true).await?, open(path, true).await?);
    find_damage([&mut connection, &mut other], "integrity_check").await?;
    other.close().await?;
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

async fn open(path: &Path, immutable: bool) -> Result<SqliteConnection> {
    let options = SqliteConnectOptions::from_str("sqlite:")?
        .filename(path)
        .read_only(true)
        .immutable(immutable)
        .busy_timeout(std::time::Duration::from_secs(5));
    Ok(SqliteConnection::connect_with(&options).await?)
}

/// A temporary name in the same folder, so that the last step is a rename.
fn beside(to: &Path) -> PathBuf {
    let mut name = std::ffi::OsString::from(".");
    name.push(to.file_name().unwrap_or_default());
    name.push(format!(".{}", uuid::Uuid::now_v7().simple()));
    to.with_file_name(name)
}

/// Deleted on drop, unless it was renamed.
struct Unfinished(PathBuf);

impl Drop for Unfinished {
    fn drop(&mut self) {
        // The file is missing if it was renamed or never created.
        let _ = std::fs::remove_file(&self.0);
    }
}
