//! The one way to write to the database: one writer at a time, and one flush for all who wait for it.
//!
//! A flush to disk takes longer than everything else about a small write. So writes that come at the same time share a transaction, a
//! *batch*: each runs inside a savepoint of its own, one after the other, and then the batch is committed for all. Nobody
//! is answered before that: what was acknowledged is on disk.
//!
//! Most of what a write says needs no answer: that a lease is over, what happened. It is left for later ([`Write::later`]) and goes with the next
//! question, the savepoint as well, and `BEGIN` with that of the first (see `statements`): a write that asks once sends two texts in all.
//!
//! Who commits? Whoever has written goes to the end of the queue again; when its turn comes, all who stood in the queue before have
//! written too, and it commits for all of them, unless someone did already. A write that meets nobody commits at once.
//!
//! Hazards:
//!
//! * *A write fails half-way, or whoever asked for it is gone.* Its savepoint is rolled back before anything else happens, the others' writes
//!   stay. Should SQLite have rolled everything back by itself, as it does when the disk is full, then nothing of the batch
//!   is there, and all of it are told to come again.
//! * *Whoever asked goes away between a statement and its answer.* What was sent is carried out, a text with several statements perhaps
//!   only up to one of them; its savepoint, which comes first, is rolled back then. Steps that concern the batch run as tasks of their own, which
//!   nobody can cancel half-way.

mod statements;

use std::sync::Arc;
use std::time::Duration;

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow};
use sqlx::{ConnectOptions as _, Connection as _, Encode, Executor as _, FromRow, Sqlite, Type};
use tokio::sync::{Mutex, OwnedMappedMutexGuard, OwnedMutexGuard, watch};

use self::statements::Statements;
use crate::error::StoreError;

/// How long a writer waits for its turn before the caller is told that the database is busy.
pub(crate) const WRITE_TURN: Duration = Duration::from_secs(5);

/// Writes of a batch, at most: the first of them waits for the last.
const LARGEST_BATCH: u32 = 64;

/// Leaves a statement for later, as [`Write::later`] does: `later!(write, "UPDATE …", a, b)`. Text and number of values are
/// checked at compile time.
macro_rules! later {
    ($write:expr, $statement:literal $(, $value:expr)* $(,)?) => {{
        // Checked, never run by itself.
        if false {
            let _ = sqlx::query!($statement $(, $value)*);
        }
        $write.later($statement)$(.bind($value))*;
    }};
}

/// Asks a question, as [`Write::ask`] does: `ask!(write, "SELECT …", a, b).first_row()`. Text and number of values are checked
/// at compile time; the answer is decoded by name.
macro_rules! ask {
    ($write:expr, $question:literal $(, $value:expr)* $(,)?) => {{
        // Checked, never run by itself.
        if false {
            let _ = sqlx::query!($question $(, $value)*);
        }
        $write.ask($question)$(.bind($value))*
    }};
}
pub(crate) use {ask, later};

/// Where writers queue. Cheap to clone; all clones are one queue.
#[derive(Clone)]
pub(crate) struct Writer {
    desk: Arc<Mutex<Desk>>,
    database: Arc<SqliteConnectOptions>,
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
    /// The connection, between two batches.
    rests: Option<SqliteConnection>,
    is_closed: bool,
}

/// A transaction that several writes share.
struct Batch {
    connection: SqliteConnection,
    /// Whether anything was sent, and `BEGIN` before it.
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
    statements: Statements,
    pub(crate) wrote_events: bool,
    pub(crate) made_work: bool,
    pub(crate) wants_plan: bool,
}

impl Write {
    /// `BEGIN IMMEDIATE` takes the write lock at once: a transaction that reads first and asks for the lock later could find
    /// that another process wrote in between, and would fail half-way.
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
            wrote_events: false,
            made_work: false,
            wants_plan: false,
        }
    }

    /// Leaves a statement for later. It runs before the next question and before the write ends. Its parameters are
    /// plain `?`. Use [`later!`] where the statement can be checked; `RELEASE` cannot.
    pub(crate) fn later(&mut self, statement: &'static str) -> Later<'_> {
        self.statements.push(statement);
        Later(self)
    }

    /// A question whose parameters are plain `?`. What was left for later goes with it. Use [`ask!`] where the
    /// question is one literal.
    pub(crate) fn ask(&mut self, question: &'static str) -> Question<'_> {
        self.statements.push(question);
        Question(self)
    }

    /// Where to ask anything else. What was left for later is done first.
    pub(crate) async fn connection(&mut self) -> Result<&mut SqliteConnection, StoreError> {
        let (connection, statements) = self.open()?;
        statements.send(connection).await?;
        Ok(connection)
    }

    /// For sending something. From here on there is something to clear up, whatever becomes of it.
    fn open(&mut self) -> Result<(&mut SqliteConnection, &mut Statements), StoreError> {
        self.statements.check()?;
        let batch = &mut *self.batch;
        batch.begun = true;
        batch.abandoned = true;
        Ok((&mut batch.connection, &mut self.statements))
    }
}

/// Binds what a statement that is left for later needs.
pub(crate) struct Later<'w>(&'w mut Write);

impl Later<'_> {
    pub fn bind<'t>(self, value: impl Encode<'t, Sqlite> + Type<Sqlite> + 't) -> Self {
        self.0.statements.bind(value);
        self
    }
}

/// A question under way. What was left for later goes before it, and with it.
#[must_use = "a question that nobody sends is left for later"]
pub(crate) struct Question<'w>(&'w mut Write);

impl Question<'_> {
    pub fn bind<'t>(self, value: impl Encode<'t, Sqlite> + Type<Sqlite> + 't) -> Self {
        self.0.statements.bind(value);
        self
    }

    /// The first row of the answer, if it has any.
    pub async fn first_row<R>(self) -> Result<Option<R>, StoreError>
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
    pub async fn write(&self) -> Result<Write, StoreError> {
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

    /// Makes the batch one that takes another write, or none.
    async fn make_room(&self, mut desk: OwnedMutexGuard<Desk>) -> OwnedMutexGuard<Desk> {
        if let Some(batch) = &mut desk.batch
            && (!clear_up(batch).await || batch.members >= LARGEST_BATCH)
        {
            desk = self.finish(desk).await;
        }
        desk
    }

    /// Makes a write last, with all others that wait for the same; then wakes those who wait for what it changed.
    pub async fn commit(&self, write: Write) -> Result<(), StoreError> {
        let writer = self.clone();
        uncancelled(async move { writer.end(write).await }).await
    }

    async fn end(self, mut write: Write) -> Result<(), StoreError> {
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
        // A batch that is gone without a word was not committed.
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
            // What is not committed must not be in the way of what comes next. It may be gone already, which SQLite says; anything else says that the
            // connection is of no use.
            _ => match connection.execute("ROLLBACK").await {
                Ok(_) | Err(sqlx::Error::Database(_)) => Some(connection),
                Err(_) => None,
            },
        };
        waiting.send_replace(Some(outcome));
        desk
    }

    /// Commits what is under way and closes the connection; further writes fail.
    pub async fn close(&self) -> Result<(), StoreError> {
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

/// Rolls a write back that ended without being committed. Whether the batch is still there afterwards.
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
