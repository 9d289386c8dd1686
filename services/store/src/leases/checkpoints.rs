//! Finished tiles of frames under way: one file per attempt, replaced as the work goes on, and deleted when
//! the task ends.
//!
//! Checkpoints are not artefacts: nothing refers to them or depends on them, and the service never reads
//! them. A pixel has the same bits on every worker, so any checkpoint of a task will do, however old. A task
//! that begins anew, because a result was refused or its frame is rendered again, ignores earlier ones.
//! Of a frame in passes, it may be from another pass: the worker takes only pixels that are not behind, and
//! not beyond its own. A lost one costs time. The worker detects a damaged one by its checksum and ignores it.

use std::path::{Path, PathBuf};

use bytes::Bytes;
use forelight_protocol::{LeaseId, TaskId, TaskKind};
use uuid::Uuid;

use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::leases::read;
use crate::leases::state::LeaseState;

/// Name of their folder in the data folder.
const FOLDER: &str = "checkpoints";

impl Store {
    /// Stores the finished tiles of a lease's frame. [`StoreError::LeaseLost`] if the lease is not the
    /// sender's.
    pub async fn put_checkpoint(&self, lease: LeaseId, fence: u64, bytes: Bytes) -> Result<()> {
        let row = read(&mut *self.readers().acquire().await?, lease).await?;
        if row.fence != fence || row.state != LeaseState::Active {
            return Err(StoreError::LeaseLost);
        }
        if !matches!(row.kind, TaskKind::Render | TaskKind::RenderPart) {
            return Err(StoreError::Conflict(format!("a {} has no tiles", row.kind)));
        }
        let (folder, file) = (self.checkpoints(), Checkpoint { task: row.task_id, fence });
        blocking(move || {
            std::fs::create_dir_all(&folder).map_err(|error| StoreError::file(&folder, error))?;
            // A temporary name, then a rename: readers see the old file or the new one, whole.
            let unfinished = folder.join(format!("{}.unfinished", Uuid::now_v7().simple()));
            let written = std::fs::write(&unfinished, &bytes)
                .and_then(|()| std::fs::rename(&unfinished, file.place(&folder)));
            written.map_err(|error| {
                // Delete the incomplete file.
                let _ = std::fs::remove_file(&unfinished);
                StoreError::file(&unfinished, error)
            })
        })
        .await
    }

    /// The tiles of a lease's frame that an earlier worker finished: those of the latest attempt that left some.
    pub async fn checkpoint(&self, lease: LeaseId) -> Result<Vec<u8>> {
        let row = read(&mut *self.readers().acquire().await?, lease).await?;
        let (folder, task) = (self.checkpoints(), row.task_id);
        let begun_anew =
            sqlx::query_scalar!(r#"SELECT begun_anew AS "fence!: u64" FROM tasks WHERE id = ?"#, task.0)
                .fetch_optional(self.readers())
                .await?;
        let fences = (begun_anew.unwrap_or(row.fence)..row.fence).rev();
        blocking(move || {
            for fence in fences.map(|before| before + 1) {
                let path = Checkpoint { task, fence }.place(&folder);
                match std::fs::read(&path) {
                    Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                    read => return read.map_err(|error| StoreError::file(&path, error)),
                }
            }
            Err(StoreError::NotFound("checkpoint"))
        })
        .await
    }

    fn checkpoints(&self) -> PathBuf {
        self.data().join(FOLDER)
    }

    /// Deletes the checkpoints of ended tasks, and old incomplete files.
    pub(crate) async fn forget_checkpoints(&self) -> Result<()> {
        let folder = self.checkpoints();
        let found: Vec<(PathBuf, Option<Checkpoint>)> = blocking(move || match std::fs::read_dir(&folder) {
            Ok(entries) => {
                Ok(entries.flatten().map(|entry| (entry.path(), Checkpoint::at(&entry.path()))).collect())
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
            Err(error) => Err(StoreError::file(&folder, error)),
        })
        .await?;
        for (path, checkpoint) in found {
            let wanted =
                match checkpoint {
                    Some(Checkpoint { task, fence }) => sqlx::query_scalar!(
                        r#"SELECT EXISTS (SELECT 1 FROM tasks WHERE id = ? AND state IN ('ready', 'leased')
                       AND begun_anew < ?) AS "wanted!: bool""#,
                        task.0,
                        i64::try_from(fence).unwrap_or(i64::MAX)
                    )
                    .fetch_one(self.readers())
                    .await?,
                    // It is being written, unless it is old.
                    None => is_recent(&path),
                };
            if !wanted {
                // If it cannot be deleted now, the next sweep tries again.
                let _ = std::fs::remove_file(&path);
            }
        }
        Ok(())
    }
}

/// Whose work a file holds: `TASK.FENCE.profile`.
struct Checkpoint {
    task: TaskId,
    fence: u64,
}

impl Checkpoint {
    fn place(&self, folder: &Path) -> PathBuf {
        folder.join(format!("{}.{}.profile", self.task, self.fence))
    }

    fn at(path: &Path) -> Option<Self> {
        let (task, fence) = path.file_name()?.to_str()?.strip_suffix(".profile")?.split_once('.')?;
        Some(Self { task: task.parse().ok()?, fence: fence.parse().ok()? })
    }
}

/// Whether a file was written within the last ten minutes, by the clock of the file system.
fn is_recent(path: &Path) -> bool {
    const MINUTES: std::time::Duration = std::time::Duration::from_secs(600);
    let modified = std::fs::metadata(path).and_then(|metadata| metadata.modified());
    modified.is_ok_and(|modified| modified.elapsed().is_ok_and(|age| age < MINUTES))
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    // It fails only when the runtime shuts down.
    tokio::task::spawn_blocking(work).await.unwrap_or(Err(StoreError::Busy))
}
