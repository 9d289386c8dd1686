//! How much projects and tokens may take: bytes of files, and open jobs.
//!
//! Open jobs and their files are counted in the write that adds one. Bytes are those that exist, and those that
//! open jobs are still to write. A job that has begun is never broken off for a quota.

use forelight_protocol::{AuditAction, Job, JobSettings, Quota, QuotaRequest, Role, Timestamp};
use sqlx::SqliteConnection;

use crate::audit::{Deed, note};
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::jobs::submitting::NewJob;
use crate::projects;
use crate::writing::run;

/// Expected bytes of a frame's files for each pixel: those of most scenes.
const BYTES_OF_PIXEL: u64 = 35;

/// Expected bytes of the files of a frame with these settings.
pub(crate) fn frame_bytes(settings: &JobSettings) -> i64 {
    let (width, height) = settings.size().unwrap_or_default();
    let pixels = u64::from(width) * u64::from(height);
    i64::try_from(pixels.saturating_mul(BYTES_OF_PIXEL)).unwrap_or(i64::MAX)
}

/// Whose quota it is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum QuotaOf<'a> {
    /// A project's.
    Project(&'a str),
    /// That of everybody who has a token of this name.
    Token(&'a str),
}

impl QuotaOf<'_> {
    fn kind(self) -> &'static str {
        match self {
            QuotaOf::Project(_) => "project",
            QuotaOf::Token(_) => "token",
        }
    }

    fn name(&self) -> &str {
        match self {
            QuotaOf::Project(name) | QuotaOf::Token(name) => name,
        }
    }

    /// The error of a quota that is used up.
    fn exceeded(self, what: String, way_out: &str) -> StoreError {
        let (kind, name) = (self.kind(), self.name());
        let flag = match self {
            QuotaOf::Project(_) => "project",
            QuotaOf::Token(_) => "who",
        };
        StoreError::QuotaExceeded(format!(
            "the {kind} {name} {what}: {way_out}, or ask an operator for more (`forelight quota --{flag} {name}`)"
        ))
    }
}

/// The number of open jobs that meet a condition.
macro_rules! open_jobs {
    ($connection:expr, $which:literal, $name:expr) => {
        sqlx::query_scalar!(
            "SELECT count(*) AS \"number!: u32\" FROM jobs \
             WHERE state IN ('previewing', 'profiling', 'quoted', 'booked', 'rendering') AND "
                + $which,
            $name
        )
        .fetch_one($connection)
        .await?
    };
}

/// The bytes of the files of jobs and bundles that meet conditions. A file counts once.
macro_rules! stored_bytes {
    ($connection:expr, $jobs:literal, $bundles:literal, $name:expr) => {
        sqlx::query_scalar!(
            "SELECT coalesce(sum(size), 0) AS \"bytes!: u64\" FROM artifacts WHERE hash IN \
             (SELECT a.hash FROM jobs j JOIN tasks t ON t.job_id = j.id JOIN result_artifacts a ON a.task_id = t.id WHERE "
                + $jobs
                + " UNION SELECT b.hash FROM bundles b WHERE b.hash IS NOT NULL AND "
                + $bundles
                + ")",
            $name
        )
        .fetch_one($connection)
        .await?
    };
}

/// The bytes that open jobs that meet a condition are still to write.
macro_rules! announced_bytes {
    ($connection:expr, $which:literal, $name:expr) => {
        sqlx::query_scalar!(
            "SELECT CAST(min(total(frame_bytes * (SELECT count(*) FROM frames f WHERE f.job_id = jobs.id \
             AND f.actual IS NULL AND f.dropped = 0)), 9e18) AS INTEGER) AS \"bytes!: u64\" FROM jobs \
             WHERE state IN ('previewing', 'profiling', 'quoted', 'booked', 'rendering') AND "
                + $which,
            $name
        )
        .fetch_one($connection)
        .await?
    };
}

impl Store {
    /// Sets a quota, or removes it if it limits nothing. The project must exist.
    pub async fn set_quota(&self, of: QuotaOf<'_>, quota: &QuotaRequest, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        run!(write, "DELETE FROM quotas WHERE kind = ? AND name = ?", of.kind(), of.name());
        if quota.storage_bytes.is_some() || quota.open_jobs.is_some() {
            if let QuotaOf::Project(project) = of {
                projects::check_exists(write.connection().await?, project).await?;
            }
            run!(
                write,
                "INSERT INTO quotas (kind, name, storage_bytes, open_jobs, updated_at) VALUES (?, ?, ?, ?, ?)",
                of.kind(),
                of.name(),
                quota.storage_bytes.map(|bytes| i64::try_from(bytes).unwrap_or(i64::MAX)),
                quota.open_jobs,
                now.micros()
            );
        }
        let deed = Deed::new(AuditAction::QuotaSet, of.name());
        let deed = match of {
            QuotaOf::Project(project) => deed.of_project(project),
            QuotaOf::Token(_) => deed,
        };
        note(&mut write, deed, Some(quota), now);
        self.commit(write).await
    }

    /// The quotas that are wanted, and how much of each is used.
    pub async fn quotas(&self, is_wanted: impl Fn(QuotaOf<'_>) -> bool) -> Result<Vec<Quota>> {
        let rows = sqlx::query!(
            r#"SELECT kind, name, storage_bytes AS "storage_bytes?: u64", open_jobs AS "open_jobs?: u32"
               FROM quotas ORDER BY kind, name"#
        )
        .fetch_all(self.readers())
        .await?;
        let mut quotas = Vec::with_capacity(rows.len());
        for row in rows {
            let is_project = row.kind == "project";
            let of = if is_project { QuotaOf::Project(&row.name) } else { QuotaOf::Token(&row.name) };
            if !is_wanted(of) {
                continue;
            }
            let mut connection = self.readers().acquire().await?;
            let used_storage_bytes = stored_bytes(&mut connection, of).await?;
            let used_open_jobs = open_jobs(&mut connection, of).await?;
            let limits = QuotaRequest {
                storage_bytes: row.storage_bytes,
                open_jobs: row.open_jobs,
                ..QuotaRequest::default()
            };
            let allowed = match is_project {
                true => QuotaRequest { project: Some(row.name), ..limits },
                false => QuotaRequest { token: Some(row.name), ..limits },
            };
            quotas.push(Quota { allowed, used_storage_bytes, used_open_jobs });
        }
        Ok(quotas)
    }

    /// Refuses so many bytes more if a quota has no room for them.
    pub async fn check_storage(&self, of: QuotaOf<'_>, more: u64) -> Result<()> {
        check_storage(&mut *self.readers().acquire().await?, of, more).await
    }

    /// Refuses a job that [`Self::create_job`] would refuse.
    pub async fn check_new_job(&self, new: &NewJob, submitter: &str, role: Role) -> Result<()> {
        let connection = &mut *self.readers().acquire().await?;
        // Operators make projects.
        if role != Role::Operator {
            projects::check_exists(connection, &new.request.project).await?;
        }
        check_new_job(connection, new, Some(submitter)).await
    }
}

/// Refuses to open a job again that is over, if a quota of its project or of its submitter has no room for so
/// many frames.
pub(crate) async fn check_open_again(
    connection: &mut SqliteConnection,
    job: &Job,
    frames: u64,
) -> Result<()> {
    let submitter = sqlx::query_scalar!("SELECT submitted_by FROM jobs WHERE id = ?", job.id.0);
    let submitter = submitter.fetch_one(&mut *connection).await?;
    let bytes = u64::try_from(frame_bytes(&job.settings)).unwrap_or(0).saturating_mul(frames);
    check_one_more(connection, &job.project, submitter.as_deref(), bytes).await
}

/// Refuses a job if a quota of its project or of its submitter has no room for it.
pub(crate) async fn check_new_job(
    connection: &mut SqliteConnection,
    new: &NewJob,
    submitter: Option<&str>,
) -> Result<()> {
    let frame = u64::try_from(frame_bytes(&new.settings)).unwrap_or(0);
    let bytes = frame.saturating_mul(new.request.frames.count());
    check_one_more(connection, &new.request.project, submitter, bytes).await
}

/// Refuses one more open job of so many bytes.
async fn check_one_more(
    connection: &mut SqliteConnection,
    project: &str,
    submitter: Option<&str>,
    bytes: u64,
) -> Result<()> {
    for of in [Some(QuotaOf::Project(project)), submitter.map(QuotaOf::Token)].into_iter().flatten() {
        check_open_jobs(connection, of).await?;
        check_storage(connection, of, bytes).await?;
    }
    Ok(())
}

/// Refuses so many bytes more if a quota has no room for them.
pub(crate) async fn check_storage(
    connection: &mut SqliteConnection,
    of: QuotaOf<'_>,
    more: u64,
) -> Result<()> {
    let most = sqlx::query_scalar!(
        r#"SELECT storage_bytes AS "most!: u64" FROM quotas
           WHERE kind = ? AND name = ? AND storage_bytes IS NOT NULL"#,
        of.kind(),
        of.name()
    );
    let Some(most) = most.fetch_optional(&mut *connection).await? else { return Ok(()) };
    let stored = stored_bytes(connection, of).await?;
    let announced = announced_bytes(connection, of).await?;
    if stored.saturating_add(announced).saturating_add(more) <= most {
        return Ok(());
    }
    let open = match announced {
        0 => String::new(),
        bytes => format!(", and its open jobs will write about {bytes}"),
    };
    let what = format!("may store {most} bytes and has {stored}{open}; this needs about {more} more");
    Err(of.exceeded(what, "delete jobs with `forelight delete`, keep less with `forelight retention`"))
}

async fn check_open_jobs(connection: &mut SqliteConnection, of: QuotaOf<'_>) -> Result<()> {
    let most = sqlx::query_scalar!(
        r#"SELECT open_jobs AS "most!: u32" FROM quotas WHERE kind = ? AND name = ? AND open_jobs IS NOT NULL"#,
        of.kind(),
        of.name()
    );
    let Some(most) = most.fetch_optional(&mut *connection).await? else { return Ok(()) };
    let open = open_jobs(connection, of).await?;
    if open < most {
        return Ok(());
    }
    Err(of
        .exceeded(format!("may have {most} open jobs and has {open}"), "wait for some of them, cancel some"))
}

async fn stored_bytes(connection: &mut SqliteConnection, of: QuotaOf<'_>) -> Result<u64> {
    Ok(match of {
        QuotaOf::Project(name) => stored_bytes!(
            connection,
            "j.project = ?1",
            "b.id IN (SELECT bundle_id FROM jobs WHERE project = ?1)",
            name
        ),
        QuotaOf::Token(name) => stored_bytes!(connection, "j.submitted_by = ?1", "b.uploaded_by = ?1", name),
    })
}

async fn announced_bytes(connection: &mut SqliteConnection, of: QuotaOf<'_>) -> Result<u64> {
    Ok(match of {
        QuotaOf::Project(name) => announced_bytes!(connection, "project = ?", name),
        QuotaOf::Token(name) => announced_bytes!(connection, "submitted_by = ?", name),
    })
}

async fn open_jobs(connection: &mut SqliteConnection, of: QuotaOf<'_>) -> Result<u32> {
    Ok(match of {
        QuotaOf::Project(name) => open_jobs!(connection, "project = ?", name),
        QuotaOf::Token(name) => open_jobs!(connection, "submitted_by = ?", name),
    })
}
