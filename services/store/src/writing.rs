//! The one way to write to the database: one writer at a time, and one flush for all who wait for it.
//!
//! A flush to disk takes longer than everything else about a small write. So writes that come at the same time share a transaction, a
//! *batch*: each runs inside a savepoint of its own, one after the other, and then the batch is committed for all. Nobody
//! is answered before that: what was acknowledged is on disk.
//!
//! Most of what a write says needs no answer: that a lease is over, what happened. A question and its answer take longer to find their way between this
//! thread and that of the connection than SQLite takes for them. So such statements are kept ([`Write::later`]), and go with the next one
//! that is asked something, or with the end of the write, a few at once and in their order.
//!
//! Who commits? Whoever has written goes to the end of the queue again; when its turn comes, all who stood in the queue before have
//! written too, and it commits for all of them, unless someone did already. A write that meets nobody commits at once.
//!
//! Hazards:
//!
//! * *A write fails half-way, or whoever asked for it is gone.* Its savepoint is rolled back before anything else happens, the others' writes
//!   stay. Should SQLite have rolled everything back by itself, as it does when the disk is full, then nothing of the batch
//!   is there, and all of it are told to come again.
//! * *Whoever asked goes away between a statement and its answer.* Steps that concern the batch run as tasks of their own, which
//!   nobody can cancel half-way.

use std::sync::Arc;
use std::time::Duration;

use sqlx::error::BoxDynError;
use sqlx::pool::PoolConnection;
use sqlx::sqlite::{SqliteArguments, SqliteConnection, SqlitePool};
use sqlx::{Arguments as _, AssertSqlSafe, Encode, Executor as _, Sqlite, Type};
use tokio::sync::{Mutex, OwnedMappedMutexGuard, OwnedMutexGuard, watch};

use crate::StoreError;

/// How long a writer waits for its turn before the caller is told that the database is busy.
pub(crate) const WRITE_TURN: Duration = Duration::from_secs(5);

/// Writes of a batch, at most: the first of them waits for the last.
const LARGEST_BATCH: u32 = 64;

/// Where writers queue. Cheap to clone; all clones are one queue.
#[derive(Clone)]
pub(crate) struct Writer {
    desk: Arc<Mutex<Desk>>,
    connections: SqlitePool,
    signals: Arc<Signals>,
}

/// What commits tell those who wait.
pub(crate) struct Signals {
    /// Raised by every commit that wrote events.
    pub events: watch::Sender<u64>,
    /// Raised by every commit that made a task ready.
    pub work: watch::Sender<u64>,
    /// Raised by every commit after which the newest plan does not know everything.
    pub plans: watch::Sender<u64>,
}

/// What lies before the writer whose turn it is.
#[derive(Default)]
struct Desk {
    batch: Option<Batch>,
}

/// A transaction that several writes share.
struct Batch {
    connection: PoolConnection<Sqlite>,
    /// Writes in it.
    members: u32,
    /// Whether the last savepoint was neither released nor rolled back.
    abandoned: bool,
    wrote_events: bool,
    made_work: bool,
    wants_plan: bool,
    outcome: watch::Sender<Option<Outcome>>,
}

/// What became of a batch.
#[derive(Clone)]
enum Outcome {
    Committed,
    Full,
    /// Nothing of it is there; the same may succeed a little later.
    Again,
    Failed(String),
}

impl Outcome {
    fn result(self) -> Result<(), StoreError> {
        match self {
            Outcome::Committed => Ok(()),
            Outcome::Full => Err(StoreError::Full),
            Outcome::Again => Err(StoreError::Busy),
            Outcome::Failed(reason) => Err(StoreError::Database(sqlx::Error::Protocol(reason))),
        }
    }
}

/// A write. It is rolled back unless it is given to [`Writer::commit`].
pub(crate) struct Write {
    batch: OwnedMappedMutexGuard<Desk, Batch>,
    writer: Writer,
    committed: bool,
    kept: Kept,
    pub(crate) wrote_events: bool,
    pub(crate) made_work: bool,
    pub(crate) wants_plan: bool,
}

impl Write {
    /// Where to ask something. What was left for later is done first.
    pub(crate) async fn connection(&mut self) -> Result<&mut SqliteConnection, StoreError> {
        self.kept.send(&mut self.batch.connection).await?;
        Ok(&mut self.batch.connection)
    }

    /// Leaves a statement for later: it is done before anything else is asked, and before the write ends. Its parameters are plain `?`.
    pub(crate) fn later(&mut self, statement: &'static str) -> Later<'_> {
        self.kept.push(statement);
        Later(&mut self.kept)
    }
}

/// Statements that go together, at most: together they are one prepared text, which is worth keeping only if it comes again. A write may leave
/// thousands, one for each frame of a job.
const MOST_TOGETHER: usize = 16;

/// Statements that are kept.
#[derive(Default)]
struct Kept {
    groups: Vec<Group>,
    /// Why one of them could not be bound.
    failed: Option<BoxDynError>,
}

/// Statements that go together, and what is bound to them.
#[derive(Default)]
struct Group {
    statements: Vec<&'static str>,
    arguments: SqliteArguments,
}

impl Kept {
    fn push(&mut self, statement: &'static str) {
        if self.groups.last().is_none_or(|group| group.statements.len() == MOST_TOGETHER) {
            self.groups.push(Group::default());
        }
        if let Some(group) = self.groups.last_mut() {
            group.statements.push(statement);
        }
    }

    /// Binds a value to the statement that was pushed last.
    fn bind<'t>(&mut self, value: impl Encode<'t, Sqlite> + Type<Sqlite> + 't) {
        if let Some(group) = self.groups.last_mut()
            && let Err(error) = group.arguments.add(value)
        {
            self.failed.get_or_insert(error);
        }
    }

    async fn send(&mut self, connection: &mut SqliteConnection) -> Result<(), StoreError> {
        let Kept { groups, failed } = std::mem::take(self);
        if let Some(error) = failed {
            return Err(sqlx::Error::Encode(error).into());
        }
        for Group { statements, arguments } in groups {
            // Put together of texts of this crate.
            let together = AssertSqlSafe(statements.join("; "));
            sqlx::query_with(together, arguments).execute(&mut *connection).await?;
        }
        Ok(())
    }
}

/// Binds what a statement that is left for later needs.
pub(crate) struct Later<'a>(&'a mut Kept);

impl Later<'_> {
    pub(crate) fn bind<'t>(self, value: impl Encode<'t, Sqlite> + Type<Sqlite> + 't) -> Self {
        self.0.bind(value);
        self
    }
}

impl Drop for Write {
    fn drop(&mut self) {
        // Someone has to clear up, and to commit for the others. Without a runtime the process ends, and the transaction with it.
        if !self.committed
            && let Ok(runtime) = tokio::runtime::Handle::try_current()
        {
            let writer = self.writer.clone();
            runtime.spawn(async move { writer.finish(writer.desk.clone().lock_owned().await).await });
        }
    }
}

impl Writer {
    pub fn new(connections: SqlitePool) -> Self {
        let sender = || watch::Sender::new(0);
        let signals = Signals { events: sender(), work: sender(), plans: sender() };
        Self { desk: Arc::default(), connections, signals: Arc::new(signals) }
    }

    pub fn signals(&self) -> &Signals {
        &self.signals
    }

    /// Begins a write. `BEGIN IMMEDIATE` takes the write lock at once: a transaction that reads first and asks for the lock later could find
    /// that another process wrote in between, and would fail half-way.
    pub async fn write(&self) -> Result<Write, StoreError> {
        let desk = tokio::time::timeout(WRITE_TURN, self.desk.clone().lock_owned());
        let desk = desk.await.map_err(|_| StoreError::Busy)?;
        let writer = self.clone();
        uncancelled(async move { writer.begin(desk).await }).await
    }

    async fn begin(self, mut desk: OwnedMutexGuard<Desk>) -> Result<Write, StoreError> {
        if let Some(batch) = &mut desk.batch
            && (!clear_up(batch).await || batch.members >= LARGEST_BATCH)
        {
            desk = self.finish(desk).await;
        }
        if desk.batch.is_none() {
            let mut connection = self.connections.acquire().await?;
            connection.execute("BEGIN IMMEDIATE").await?;
            desk.batch = Some(Batch {
                connection,
                members: 0,
                abandoned: false,
                wrote_events: false,
                made_work: false,
                wants_plan: false,
                outcome: watch::Sender::new(None),
            });
        }
        let Ok(mut batch) = OwnedMutexGuard::try_map(desk, |desk| desk.batch.as_mut()) else {
            return Err(StoreError::Busy);
        };
        batch.abandoned = true;
        let savepoint = batch.connection.execute("SAVEPOINT one").await;
        // From here on dropping it clears up, whatever has happened.
        let write = Write {
            batch,
            writer: self,
            committed: false,
            kept: Kept::default(),
            wrote_events: false,
            made_work: false,
            wants_plan: false,
        };
        savepoint?;
        Ok(write)
    }

    /// Makes a write last, with all others that wait for the same; then wakes those who wait for what it changed.
    pub async fn commit(&self, write: Write) -> Result<(), StoreError> {
        let writer = self.clone();
        uncancelled(async move { writer.end(write).await }).await
    }

    async fn end(self, mut write: Write) -> Result<(), StoreError> {
        write.kept.push("RELEASE one");
        write.kept.send(&mut write.batch.connection).await?;
        let (events, work, plans) = (write.wrote_events, write.made_work, write.wants_plan);
        let batch = &mut write.batch;
        batch.abandoned = false;
        batch.members += 1;
        batch.wrote_events |= events;
        batch.made_work |= work;
        batch.wants_plan |= plans;
        let mut outcome = batch.outcome.subscribe();
        write.committed = true;
        drop(write);
        let desk = tokio::select! {
            biased;
            _ = outcome.wait_for(Option::is_some) => None,
            desk = self.desk.clone().lock_owned() => Some(desk),
        };
        if let Some(desk) = desk
            && outcome.borrow().is_none()
        {
            drop(self.finish(desk).await);
        }
        let outcome = outcome.borrow().clone();
        // A batch that is gone without a word was not committed.
        outcome.unwrap_or(Outcome::Again).result()
    }

    /// Commits the batch, if there is one.
    async fn finish(&self, mut desk: OwnedMutexGuard<Desk>) -> OwnedMutexGuard<Desk> {
        let Some(mut batch) = desk.batch.take() else { return desk };
        let outcome = if clear_up(&mut batch).await { commit(&mut batch).await } else { Outcome::Again };
        if !matches!(outcome, Outcome::Committed) {
            // What is not committed must not be in the way of what comes next. It may be gone already.
            let _ = batch.connection.execute("ROLLBACK").await;
        }
        let Batch { connection, wrote_events, made_work, wants_plan, outcome: waiting, .. } = batch;
        drop(connection);
        if matches!(outcome, Outcome::Committed) {
            let signals = &self.signals;
            for (happened, signal) in
                [(wrote_events, &signals.events), (made_work, &signals.work), (wants_plan, &signals.plans)]
            {
                if happened {
                    signal.send_modify(|version| *version = version.wrapping_add(1));
                }
            }
        }
        waiting.send_replace(Some(outcome));
        desk
    }
}

async fn commit(batch: &mut Batch) -> Outcome {
    match batch.connection.execute("COMMIT").await.map_err(StoreError::from) {
        Ok(_) => Outcome::Committed,
        Err(StoreError::Full) => Outcome::Full,
        Err(StoreError::Busy) => Outcome::Again,
        Err(error) => Outcome::Failed(error.to_string()),
    }
}

/// Rolls a write back that ended without being committed. Whether the batch is still there afterwards.
async fn clear_up(batch: &mut Batch) -> bool {
    if !batch.abandoned {
        return true;
    }
    for statement in ["ROLLBACK TO one", "RELEASE one"] {
        if let Err(error) = batch.connection.execute(statement).await {
            tracing::warn!(%error, writes = batch.members, "SQLite rolled a transaction back by itself");
            return false;
        }
    }
    batch.abandoned = false;
    true
}

/// Runs to its end even if whoever waits for it goes away.
async fn uncancelled<T: Send + 'static>(
    work: impl Future<Output = Result<T, StoreError>> + Send + 'static,
) -> Result<T, StoreError> {
    match tokio::spawn(work).await {
        Ok(done) => done,
        // The runtime ends.
        Err(_) => Err(StoreError::Busy),
    }
}
