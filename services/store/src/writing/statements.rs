//! Deferred statements.
//!
//! A question and its answer spend more time between this thread and the connection's thread than in SQLite.
//! So statements without an answer are collected and sent with the next question, or at the end of the write,
//! as one text and in their order.

use sqlx::error::BoxDynError;
use sqlx::sqlite::{SqliteArguments, SqliteConnection};
use sqlx::{Arguments as _, AssertSqlSafe, Encode, Executor as _, Sqlite, Type};

use crate::error::Result;

/// Most statements in one text. A text is prepared as a whole, which pays only if it comes again; a write may
/// defer thousands of statements, one for each frame of a job.
const MOST_TOGETHER: usize = 16;

/// The deferred statements of a write.
#[derive(Default)]
pub(super) struct Statements {
    groups: Vec<Group>,
    /// The first error of binding a value.
    failed: Option<BoxDynError>,
}

/// Statements of one text, and their values.
#[derive(Default)]
pub(super) struct Group {
    statements: Vec<&'static str>,
    arguments: SqliteArguments,
}

impl Group {
    pub fn together(self) -> sqlx::query::Query<'static, Sqlite, SqliteArguments> {
        // All parts are literals of this crate.
        sqlx::query_with(AssertSqlSafe(self.statements.join("; ")), self.arguments)
    }
}

impl Statements {
    /// Adds a statement. Its parameters have no numbers: they are counted through all statements of a text.
    pub fn push(&mut self, statement: &'static str) {
        debug_assert!(!statement.contains("?1"), "parameters with numbers: {statement}");
        if self.groups.last().is_none_or(|group| group.statements.len() == MOST_TOGETHER) {
            self.groups.push(Group::default());
        }
        if let Some(group) = self.groups.last_mut() {
            group.statements.push(statement);
        }
    }

    /// Binds a value to the statement that was pushed last.
    pub fn bind<'t>(&mut self, value: impl Encode<'t, Sqlite> + Type<Sqlite> + 't) {
        if let Some(group) = self.groups.last_mut()
            && let Err(error) = group.arguments.add(value)
        {
            self.failed.get_or_insert(error);
        }
    }

    /// Sends all statements, if there are any.
    pub async fn send(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        if let Some(last) = self.send_but_the_last(connection).await? {
            connection.execute(last.together()).await?;
        }
        Ok(())
    }

    /// Fails if a value could not be bound. Call it before sending.
    pub fn check(&mut self) -> Result<()> {
        match self.failed.take() {
            Some(error) => Err(sqlx::Error::Encode(error).into()),
            None => Ok(()),
        }
    }

    /// Sends all texts but the last, and returns that one.
    pub async fn send_but_the_last(
        &mut self,
        connection: &mut SqliteConnection,
    ) -> Result<Option<Group>, sqlx::Error> {
        let mut groups = std::mem::take(&mut self.groups);
        let last = groups.pop();
        for group in groups {
            connection.execute(group.together()).await?;
        }
        Ok(last)
    }
}
