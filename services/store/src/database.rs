//! Opens the database and reads from it. `writing` writes to it.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use forelight_protocol::Timestamp;
use sqlx::sqlite::{
    SqliteAutoVacuum, SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool,
    SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions as _, Connection as _, Sqlite, Transaction};
use tokio::sync::watch;

use crate::actor::Actor;
use crate::artifacts::{ArtifactPlace, Artifacts};
use crate::error::{Result, StoreError};
use crate::writing::{WRITE_TURN, Writer};
pub(crate) use crate::writing::{Write, run};

/// How long SQLite waits for a lock of another process, such as `forelight token` beside a running service.
const LOCK_WAIT: Duration = Duration::from_secs(5);

/// Read-only connections of each lane. With a write-ahead log, readers and the writer never wait for each
/// other.
const READERS: u32 = 4;

/// Name of the database in the data folder.
pub const DATABASE: &str = "forelight.sqlite";

static MIGRATIONS: sqlx::migrate::Migrator = sqlx::migrate!("../../migrations");

/// The farm's database and artefacts. Cheap to clone; all clones are one store.
#[derive(Clone)]
pub struct Store {
    inner: Arc<Inner>,
    asks: Asks,
    /// Who makes the changes, see [`Store::acting_for`].
    actor: Option<Arc<Actor>>,
}

/// Who asks. Each has connections of its own, so that nothing else makes workers wait, and people do not make
/// plans wait.
#[derive(Clone, Copy)]
enum Asks {
    Workers,
    Service,
    People,
}

/// Connections for reading, and the artefacts that are looked up by them.
struct Lane {
    readers: SqlitePool,
    artifacts: Artifacts,
}

struct Inner {
    writer: Writer,
    workers: Lane,
    service: Lane,
    people: Lane,
    /// Start of the service in microseconds.
    up_since: AtomicI64,
    data: PathBuf,
    /// Held while the store is open. The operating system releases it when the process dies.
    _lock: Option<Lock>,
}

impl Store {
    /// Opens the store in `data` for a service: checks the database, brings the schema up to date and deletes
    /// unfinished uploads. Only one process at a time can do this. A damaged database is refused before
    /// anything is written to it. Artefacts are kept in the data folder.
    pub async fn open(data: &Path) -> Result<Self> {
        Self::open_with(data, &ArtifactPlace::DataFolder, false).await
    }

    /// As [`Store::open`], with artefacts in this place. A farm that has artefacts elsewhere is refused,
    /// unless they `moved`: they were copied by hand.
    pub async fn open_with(data: &Path, artifacts: &ArtifactPlace, moved: bool) -> Result<Self> {
        std::fs::create_dir_all(data).map_err(|error| StoreError::file(data, error))?;
        restrict(data, 0o700)?;
        let lock = lock(data)?;
        let opened = Self::open_shared(data, Some(lock), artifacts).await;
        let store = opened.map_err(|error| match error {
            StoreError::Corrupt(reason) => {
                StoreError::Damaged { path: data.join(DATABASE).display().to_string(), reason }
            }
            other => other,
        })?;
        store.settle_artifact_place(artifacts, moved).await?;
        store.artifacts().discard_unfinished().await?;
        store.artifacts().probe().await?;
        Ok(store)
    }

    /// Opens the store in `data` beside a service that may be running, for small administration such as
    /// making a token. Brings the schema up to date but does not check the database.
    pub async fn open_beside(data: &Path) -> Result<Self> {
        std::fs::create_dir_all(data).map_err(|error| StoreError::file(data, error))?;
        Self::open_shared(data, None, &ArtifactPlace::DataFolder).await
    }

    /// As [`Store::open_beside`], with artefacts where the farm keeps them.
    pub async fn open_beside_with_artifacts(data: &Path) -> Result<Self> {
        let beside = Self::open_beside(data).await?;
        let place: Option<String> =
            sqlx::query_scalar!("SELECT place FROM artifact_place").fetch_optional(beside.readers()).await?;
        let place = place.as_deref().map(str::parse::<ArtifactPlace>).transpose();
        let place = place.map_err(|error| StoreError::ArtifactPlace(error.to_string()))?;
        match place {
            None | Some(ArtifactPlace::DataFolder) => Ok(beside),
            Some(place) => {
                beside.close().await;
                Self::open_shared(data, None, &place).await
            }
        }
    }

    async fn open_shared(data: &Path, lock: Option<Lock>, at: &ArtifactPlace) -> Result<Self> {
        let path = data.join(DATABASE);
        let options = SqliteConnectOptions::from_str("sqlite:")?
            .filename(&path)
            .foreign_keys(true)
            .journal_mode(SqliteJournalMode::Wal)
            .busy_timeout(LOCK_WAIT);
        let writable = options
            .clone()
            .create_if_missing(true)
            .auto_vacuum(SqliteAutoVacuum::Incremental)
            .synchronous(SqliteSynchronous::Full);
        let mut connection = writable.connect().await?;
        restrict_to_owner(&path)?;
        if lock.is_some() {
            // What a row may contain is looked at when it is read. Looking at all rows here would double the time.
            let checking = options.clone().read_only(true).pragma("ignore_check_constraints", "ON");
            let mut other = checking.connect().await?;
            find_damage([&mut other, &mut connection], "quick_check").await?;
            other.close().await?;
        }
        MIGRATIONS.run(&mut connection).await?;
        let writer = Writer::new(connection, writable.create_if_missing(false));
        let options = options.read_only(true);
        let readers = || {
            SqlitePoolOptions::new()
                .max_connections(READERS)
                .acquire_timeout(WRITE_TURN)
                // The database is in this process, so a connection cannot be closed by a server.
                .test_before_acquire(false)
                .idle_timeout(None)
                .max_lifetime(None)
                .connect_lazy_with(options.clone())
        };
        let of_workers = readers();
        let artifacts = Artifacts::open(&data.join("artifacts"), at, writer.clone(), of_workers.clone())?;
        let lane = || {
            let readers = readers();
            Lane { artifacts: artifacts.read_by(readers.clone()), readers }
        };
        let (service, people) = (lane(), lane());
        let inner = Inner {
            writer,
            workers: Lane { readers: of_workers, artifacts },
            service,
            people,
            up_since: AtomicI64::new(i64::MIN),
            data: data.to_owned(),
            _lock: lock,
        };
        Ok(Self { inner: Arc::new(inner), asks: Asks::Workers, actor: None })
    }

    /// The same store, for what the service does by itself, such as plans.
    pub fn for_service(&self) -> Self {
        Self { asks: Asks::Service, ..self.clone() }
    }

    /// The same store, for what people look at.
    pub fn for_people(&self) -> Self {
        Self { asks: Asks::People, ..self.clone() }
    }

    /// Opens all connections for reading. Each has a thread, which inherits the priority of the thread that
    /// runs this.
    pub async fn connect(&self) -> Result<()> {
        let connections = (0..READERS).map(|_| self.readers().acquire());
        futures::future::try_join_all(connections).await?;
        Ok(())
    }

    fn lane(&self) -> &Lane {
        match self.asks {
            Asks::Workers => &self.inner.workers,
            Asks::Service => &self.inner.service,
            Asks::People => &self.inner.people,
        }
    }

    /// The same store for changes by somebody, whom the audit names.
    pub fn acting_for(&self, actor: Actor) -> Self {
        Self { actor: Some(Arc::new(actor)), ..self.clone() }
    }

    /// The files named by their hash.
    pub fn artifacts(&self) -> &Artifacts {
        &self.lane().artifacts
    }

    /// When the service started. No node was heard of before.
    pub fn up_since(&self) -> Timestamp {
        Timestamp::from_micros(self.inner.up_since.load(Ordering::Relaxed))
    }

    pub(crate) fn set_up_since(&self, now: Timestamp) {
        self.inner.up_since.store(now.micros(), Ordering::Relaxed);
    }

    pub(crate) fn data(&self) -> &Path {
        &self.inner.data
    }

    /// Changes whenever events were written.
    pub fn watch_events(&self) -> watch::Receiver<u64> {
        self.inner.writer.signals().events.subscribe()
    }

    /// Changes whenever a task became ready.
    pub fn watch_work(&self) -> watch::Receiver<u64> {
        self.inner.writer.signals().work.subscribe()
    }

    /// Changes whenever something happens that the newest plan does not take into account.
    pub fn watch_plans(&self) -> watch::Receiver<u64> {
        self.inner.writer.signals().plans.subscribe()
    }

    /// Closes all connections and waits for them. Further calls fail.
    pub async fn close(&self) {
        for lane in [&self.inner.people, &self.inner.service, &self.inner.workers] {
            lane.readers.close().await;
        }
        if let Err(error) = self.inner.writer.close().await {
            tracing::warn!(%error, "the database was not closed properly");
        }
    }

    /// Whether the database answers.
    pub async fn ping(&self) -> Result<()> {
        sqlx::query_scalar!("SELECT 1 AS one").fetch_one(self.readers()).await?;
        Ok(())
    }

    /// Free bytes on the disk of the data folder.
    pub fn free_disk_space(&self) -> Result<u64> {
        let there = rustix::fs::statvfs(&self.inner.data);
        let there = there.map_err(|error| StoreError::file(&self.inner.data, error.into()))?;
        Ok(there.f_bavail.saturating_mul(there.f_frsize))
    }

    pub(crate) fn readers(&self) -> &SqlitePool {
        &self.lane().readers
    }

    /// Begins a write.
    pub(crate) async fn write(&self) -> Result<Write> {
        Ok(self.inner.writer.write().await?.by(self.actor.clone()))
    }

    /// Begins a read transaction: all its statements see the same state.
    pub(crate) async fn read(&self) -> Result<Transaction<'static, Sqlite>> {
        Ok(self.lane().readers.begin().await?)
    }

    pub(crate) async fn commit(&self, write: Write) -> Result<()> {
        self.inner.writer.commit(write).await
    }

    /// Stores where artefacts are kept. With another place, the farm would have rows of missing files.
    async fn settle_artifact_place(&self, place: &ArtifactPlace, moved: bool) -> Result<()> {
        let mut write = self.write().await?;
        let known = sqlx::query_scalar!("SELECT place FROM artifact_place")
            .fetch_optional(write.connection().await?)
            .await?;
        // Older farms have no such row: they kept artefacts in the data folder.
        let known = known.unwrap_or_else(|| ArtifactPlace::DataFolder.to_string());
        let any = sqlx::query_scalar!(r#"SELECT EXISTS (SELECT 1 FROM artifacts) AS "any!: bool""#)
            .fetch_one(write.connection().await?)
            .await?;
        if any && !moved && known != place.to_string() {
            return Err(StoreError::ArtifactPlace(format!(
                "{place}: this farm's are in {known}; start it with --artifacts {known}, or copy the folder \
                 `blake3` from there to {place} and add --artifacts-moved once"
            )));
        }
        run!(
            write,
            "INSERT INTO artifact_place (one, place) VALUES (1, ?) ON CONFLICT DO UPDATE \
             SET place = excluded.place",
            place.to_string()
        );
        self.commit(write).await
    }
}

/// Looks for damage, by `quick_check` (pages, order of keys) or `integrity_check` (indexes against tables as
/// well) on the first connection, and for rows with dangling references on the second one, to the same
/// database, at the same time: each takes much of a second for 500 MB.
pub(crate) async fn find_damage(connections: [&mut SqliteConnection; 2], check: &'static str) -> Result<()> {
    let [first, second] = connections;
    // A pragma's name cannot be a parameter.
    let check = sqlx::AssertSqlSafe(format!("PRAGMA {check}(10)"));
    let complaints = sqlx::query_scalar(check).fetch_all(first);
    let (complaints, dangling): (Result<Vec<String>, _>, _) = tokio::join!(complaints, find_dangling(second));
    let complaints = complaints?;
    if complaints != ["ok"] {
        return Err(StoreError::Corrupt(complaints.join("; ")));
    }
    match dangling? {
        None => Ok(()),
        Some(table) => Err(StoreError::Corrupt(format!("a row of {table} refers to a missing row"))),
    }
}

/// A table with a row that refers to a missing one. As `PRAGMA foreign_key_check`, which reads all rows whole;
/// this reads indexes where there are some, and takes half the time.
async fn find_dangling(connection: &mut SqliteConnection) -> Result<Option<String>> {
    // The tables of a pragma cannot be checked at compile time.
    let references: Vec<(String, String)> = sqlx::query_as(
        r#"SELECT m.name, format(
               'SELECT EXISTS (SELECT 1 FROM "%w" c WHERE %s AND NOT EXISTS (SELECT 1 FROM "%w" p WHERE %s))',
               m.name, group_concat(format('c."%w" IS NOT NULL', f."from"), ' AND '),
               f."table", group_concat(format('p."%w" = c."%w"', f."to", f."from"), ' AND '))
           FROM sqlite_schema m, pragma_foreign_key_list(m.name) f
           WHERE m.type = 'table' GROUP BY m.name, f.id"#,
    )
    .fetch_all(&mut *connection)
    .await?;
    for (table, dangles) in references {
        if sqlx::query_scalar(sqlx::AssertSqlSafe(dangles)).fetch_one(&mut *connection).await? {
            return Ok(Some(table));
        }
    }
    Ok(None)
}

/// Locks that only one service can hold: of the data folder itself, and of a file in it.
///
/// Hazard: whoever removes the file lets another service lock a new one. The folder cannot be removed while
/// there is something in it. The file stays, for services of versions that know only it.
type Lock = [File; 2];

fn lock(data: &Path) -> Result<Lock> {
    let path = data.join("service.lock");
    let file = File::options().create(true).truncate(false).write(true).open(&path);
    let file = file.map_err(|error| StoreError::file(&path, error))?;
    let folder = File::open(data).map_err(|error| StoreError::file(data, error))?;
    for (file, path) in [(&folder, data), (&file, &path)] {
        match file.try_lock() {
            Ok(()) => {}
            Err(std::fs::TryLockError::WouldBlock) => {
                return Err(StoreError::InUse(data.display().to_string()));
            }
            Err(std::fs::TryLockError::Error(error)) => return Err(StoreError::file(path, error)),
        }
    }
    Ok([folder, file])
}

/// The database holds hashes of tokens and names of unreleased films: other users must not read it.
pub(crate) fn restrict_to_owner(path: &Path) -> Result<()> {
    restrict(path, 0o600)
}

fn restrict(path: &Path, mode: u32) -> Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))
        .map_err(|error| StoreError::file(path, error))
}
