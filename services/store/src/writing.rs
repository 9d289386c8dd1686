//! The only way to write to the database: one writer at a time, and one flush for all waiting writers.
//!
//! A flush takes longer than everything else about a small write. So concurrent writes share a transaction, a
//! *batch*. Each runs in a savepoint of its own, one after the other; then the batch is committed for all. No
//! caller is answered before that, so everything acknowledged is on disk.
//!
//! Most statements of a write return nothing. They are deferred ([`Write::later`]) and sent with the next
//! question, together with the savepoint and, in the first write of a batch, `BEGIN` (see `statements`). So a
//! write that asks once sends two texts in all.
//!
//! Which writer commits? A finished write joins the end of the queue again. When its turn comes, all that
//! were queued before it have written too, and it commits for all of them, unless one of them has already. A
//! write without others commits at once.
//!
//! Hazards:
//!
//! * *A write fails half-way, or its caller is gone.* Its savepoint is rolled back before anything else
//!   happens; the others' writes stay. SQLite may roll the whole transaction back by itself, for example when
//!   the disk is full. Then nothing of the batch is written, and all its writers are told to try again.
//! * *The caller goes away between a statement and its answer.* What was sent is carried out, perhaps only up
//!   to one of several statements. The savepoint comes first, so it is rolled back then. Steps that concern
//!   the batch run as tasks of their own, which cannot be cancelled half-way.

mod statements;

use std::sync::Arc;
use std::time::Duration;

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow};
use sqlx::{ConnectOptions as _, Connection as _, Encode, Executor as _, FromRow, Sqlite, Type};
use tokio::sync::{Mutex, OwnedMappedMutexGuard, OwnedMutexGuard, watch};

use self::statements::Statements;
use crate::actor::Actor;
use crate::error::{Result, StoreError};

/// How long a writer waits for its turn before its caller gets [`StoreError::Busy`].
pub(crate) const WRITE_TURN: Duration = Duration::from_secs(5);

/// Most writes of a batch: the first of them waits for the last.
const LARGEST_BATCH: u32 = 64;

/// Defers a statement, as [`Write::later`] does: `later!(write, "UPDATE …", a, b)`. The text and the number
/// of values are checked at compile time.
macro_rules! later {
    ($write:expr, $statement:literal $(, $value:expr)* $(,)?) => {{
        // Checked, never run by itself.
        if false {
            let _ = sqlx::query!($statement $(, $value)*);
        }
        $write.later($statement)$(.bind($value))*;
    }};
}

/// Asks a question, as [`Write::ask`] does: `ask!(write, "SELECT …", a, b).first_row()`. The text and the
/// number of values are checked at compile time; the answer is decoded by name.
macro_rules! ask {
    ($write:expr, $question:literal $(, $value:expr)* $(,)?) => {{
        // Checked, never run by itself.
        if false {
            let _ = sqlx::query!($question $(, $value)*);
        }
        $write.ask($question)$(.bind($value))*
    }};
}

/// Runs a statement inside a write, after the deferred ones, and returns how many rows it changed:
/// `run!(write, "UPDATE …", a, b)`. Awaits, and returns errors from the calling function.
macro_rules! run {
    ($write:expr, $statement:literal $(, $value:expr)* $(,)?) => {
        sqlx::query!($statement $(, $value)*).execute($write.connection().await?).await?.rows_affected()
    };
}
pub(crate) use {ask, later, run};

/// The queue of writers. Cheap to clone; all clones are one queue.
#[derive(Clone)]
pub(crate) struct Writer {
    desk: Arc<Mutex<Desk>>,
    database: Arc<SqliteConnectOptions>,
    signals: Arc<Signals>,
}

/// Signals that commits send.
pub(crate) struct Signals {
    /// Raised by every commit that wrote events.
    pub events: watch::Sender<u64>,
    /// Raised by every commit that made a task ready.
    pub work: watch::Sender<u64>,
    /// Raised by every commit that the newest plan does not take into account.
    pub plans: watch::Sender<u64>,
}

/// What the writer at the head of the queue works with.
#[derive(Default)]
struct Desk {
    batch: Option<Batch>,
    /// The connection between two batches.
    rests: Option<SqliteConnection>,
    is_closed: bool,
}

/// A transaction that several writes share.
struct Batch {
    connection: SqliteConnection,
    /// Whether `BEGIN` was sent.
    begun: bool,
    /// Writes in it.
    members: u32,
    /// Whether the last savepoint was neither released nor rolled back.
    abandoned: bool,
    wrote_events: bool,
    made_work: bool,
    wants_plan: bool,
    outcome: watch::Sender<Option<Outcome>>,
}

impl Batch {
    fn new(connection: SqliteConnection) -> Self {
        Self {
            connection,
            begun: false,
            members: 0,
            abandoned: false,
            wrote_events: false,
            made_work: false,
            wants_plan: false,
            outcome: watch::Sender::new(None),
        }
    }
}

/// The outcome of a batch.
#[derive(Clone)]
enum Outcome {
    Committed,
    Full,
    /// Nothing of it was written; the same may succeed later.
    Again,
    Failed(String),
}

impl Outcome {
    fn result(self) -> Result<()> {
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
    statements: Statements,
    actor: Option<Arc<Actor>>,
    pub(crate) wrote_events: bool,
    pub(crate) made_work: bool,
    pub(crate) wants_plan: bool,
}

impl Write {
    /// The same write by somebody, whom the audit names.
    pub(crate) fn by(mut self, actor: Option<Arc<Actor>>) -> Self {
        self.actor = actor;
        self
    }

    /// Who writes. `None` for the service itself, and for commands beside it.
    pub(crate) fn actor(&self) -> Option<Arc<Actor>> {
        self.actor.clone()
    }

    /// `BEGIN IMMEDIATE` takes the write lock at once. A transaction that reads first could find that another
    /// process wrote in between, and would fail half-way.
    fn new(batch: OwnedMappedMutexGuard<Desk, Batch>, writer: Writer) -> Self {
        let mut statements = Statements::default();
        if !batch.begun {
            statements.push("BEGIN IMMEDIATE");
        }
        statements.push("SAVEPOINT one");
        Self {
            batch,
            writer,
            committed: false,
            statements,
            actor: None,
            wrote_events: false,
            made_work: false,
            wants_plan: false,
        }
    }

    /// Defers a statement. It runs before the next question and before the write ends. Its parameters are
    /// plain `?`. Use [`later!`] where the statement can be checked; `RELEASE` cannot.
    pub(crate) fn later(&mut self, statement: &'static str) -> Later<'_> {
        self.statements.push(statement);
        Later(self)
    }

    /// Asks a question with plain `?` parameters. Deferred statements go with it. Use [`ask!`] where the
    /// question is one literal.
    pub(crate) fn ask(&mut self, question: &'static str) -> Question<'_> {
        self.statements.push(question);
        Question(self)
    }

    /// The connection, for any other statement. Deferred statements are sent first.
    pub(crate) async fn connection(&mut self) -> Result<&mut SqliteConnection> {
        let (connection, statements) = self.open()?;
        statements.send(connection).await?;
        Ok(connection)
    }

    /// Prepares for sending. From here on, the write has to be cleared up if it is not committed.
    fn open(&mut self) -> Result<(&mut SqliteConnection, &mut Statements)> {
        self.statements.check()?;
        let batch = &mut *self.batch;
        batch.begun = true;
        batch.abandoned = true;
        Ok((&mut batch.connection, &mut self.statements))
    }
}

/// Binds the values of a deferred statement.
pub(crate) struct Later<'w>(&'w mut Write);

impl Later<'_> {
    pub fn bind<'t>(self, value: impl Encode<'t, Sqlite> + Type<Sqlite> + 't) -> Self {
        self.0.statements.bind(value);
        self
    }
}

/// A question that values are bound to. Deferred statements are sent before it, in the same text.
#[must_use = "a question that nobody sends is left for later"]
pub(crate) struct Question<'w>(&'w mut Write);

impl Question<'_> {
    pub fn bind<'t>(self, value: impl Encode<'t, Sqlite> + Type<Sqlite> + 't) -> Self {
        self.0.statements.bind(value);
        self
    }

    /// The first row of the answer, if it has any.
    pub async fn first_row<R>(self) -> Result<Option<R>>
    where
        R: for<'r> FromRow<'r, SqliteRow>,
    {
        let (connection, statements) = self.0.open()?;
        let Some(last) = statements.send_but_the_last(connection).await? else { return Ok(None) };
        let row = connection.fetch_optional(last.together()).await?;
        Ok(row.as_ref().map(R::from_row).transpose()?)
    }
}

impl Drop for Write {
    fn drop(&mut self) {
        // Another task clears up, and commits for the others. Without a runtime the process is ending, and
        // the transaction with it.
        if !self.committed
            && let Ok(runtime) = tokio::runtime::Handle::try_current()
        {
            let writer = self.writer.clone();
            runtime.spawn(async move { writer.finish(writer.desk.clone().lock_owned().await).await });
        }
    }
}

impl Writer {
    /// Writes to this database, by a connection of its own.
    pub fn new(connection: SqliteConnection, database: SqliteConnectOptions) -> Self {
        let sender = || watch::Sender::new(0);
        let signals = Signals { events: sender(), work: sender(), plans: sender() };
        let desk = Desk { rests: Some(connection), ..Desk::default() };
        Self { desk: Arc::new(Mutex::new(desk)), database: Arc::new(database), signals: Arc::new(signals) }
    }

    pub fn signals(&self) -> &Signals {
        &self.signals
    }

    /// Begins a write.
    pub async fn write(&self) -> Result<Write> {
        let desk = tokio::time::timeout(WRITE_TURN, self.desk.clone().lock_owned());
        let mut desk = desk.await.map_err(|_| StoreError::Busy)?;
        if desk.batch.as_ref().is_some_and(|batch| batch.abandoned || batch.members >= LARGEST_BATCH) {
            let writer = self.clone();
            desk = uncancelled(async move { Ok(writer.make_room(desk).await) }).await?;
        }
        if desk.is_closed {
            return Err(sqlx::Error::PoolClosed.into());
        }
        if desk.batch.is_none() {
            let connection = match desk.rests.take() {
                Some(connection) => connection,
                None => self.database.connect().await?,
            };
            desk.batch = Some(Batch::new(connection));
        }
        match OwnedMutexGuard::try_map(desk, |desk| desk.batch.as_mut()) {
            Ok(batch) => Ok(Write::new(batch, self.clone())),
            Err(_) => Err(StoreError::Busy),
        }
    }

    /// Clears the batch up, and commits it if it cannot take another write.
    async fn make_room(&self, mut desk: OwnedMutexGuard<Desk>) -> OwnedMutexGuard<Desk> {
        if let Some(batch) = &mut desk.batch
            && (!clear_up(batch).await || batch.members >= LARGEST_BATCH)
        {
            desk = self.finish(desk).await;
        }
        desk
    }

    /// Commits a write together with all others that wait, then wakes those who wait for its changes.
    pub async fn commit(&self, write: Write) -> Result<()> {
        let writer = self.clone();
        uncancelled(async move { writer.end(write).await }).await
    }

    async fn end(self, mut write: Write) -> Result<()> {
        write.later("RELEASE one");
        write.connection().await?;
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
        // A batch without an outcome was not committed.
        outcome.unwrap_or(Outcome::Again).result()
    }

    /// Commits the batch, if there is one.
    async fn finish(&self, mut desk: OwnedMutexGuard<Desk>) -> OwnedMutexGuard<Desk> {
        let Some(mut batch) = desk.batch.take() else { return desk };
        let outcome = if clear_up(&mut batch).await { commit(&mut batch).await } else { Outcome::Again };
        let Batch { mut connection, wrote_events, made_work, wants_plan, outcome: waiting, .. } = batch;
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
        desk.rests = match outcome {
            Outcome::Committed => Some(connection),
            // An open transaction must not get in the way of the next batch. SQLite reports an error if it is
            // already rolled back; any other error means that the connection is unusable.
            _ => match connection.execute("ROLLBACK").await {
                Ok(_) | Err(sqlx::Error::Database(_)) => Some(connection),
                Err(_) => None,
            },
        };
        waiting.send_replace(Some(outcome));
        desk
    }

    /// Commits the batch and closes the connection. Further writes fail.
    pub async fn close(&self) -> Result<()> {
        let mut desk = self.finish(self.desk.clone().lock_owned().await).await;
        desk.is_closed = true;
        match desk.rests.take() {
            Some(connection) => Ok(connection.close().await?),
            None => Ok(()),
        }
    }
}

async fn commit(batch: &mut Batch) -> Outcome {
    if !batch.begun {
        return Outcome::Committed;
    }
    match batch.connection.execute("COMMIT").await.map_err(StoreError::from) {
        Ok(_) => Outcome::Committed,
        Err(StoreError::Full) => Outcome::Full,
        Err(StoreError::Busy) => Outcome::Again,
        Err(error) => Outcome::Failed(error.to_string()),
    }
}

/// Rolls back a write that ended without being committed. Returns whether the batch still exists.
async fn clear_up(batch: &mut Batch) -> bool {
    if !batch.abandoned {
        return true;
    }
    for statement in ["ROLLBACK TO one", "RELEASE one"] {
        if let Err(error) = batch.connection.execute(statement).await {
            if batch.members > 0 {
                tracing::warn!(%error, writes = batch.members, "SQLite rolled a transaction back by itself");
            }
            return false;
        }
    }
    batch.abandoned = false;
    true
}

/// Runs to its end even if the caller goes away.
async fn uncancelled<T: Send + 'static>(work: impl Future<Output = Result<T>> + Send + 'static) -> Result<T> {
    match tokio::spawn(work).await {
        Ok(done) => done,
        // The runtime is shutting down.
        Err(_) => Err(StoreError::Busy),
    }
}
