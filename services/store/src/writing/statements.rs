//! Statements on their way to the database.
//!
//! A question and its answer take longer to find their way between this thread and that of the connection than SQLite takes for them. So what
//! needs no answer is kept, and goes with the next question, or with the end of the write, as one text and in its order.

use sqlx::error::BoxDynError;
use sqlx::sqlite::{SqliteArguments, SqliteConnection};
use sqlx::{Arguments as _, AssertSqlSafe, Encode, Executor as _, Sqlite, Type};

use crate::error::StoreError;

/// Statements that go together, at most: together they are one prepared text, which is worth keeping only if it comes again. A write may leave
/// thousands, one for each frame of a job.
const MOST_TOGETHER: usize = 16;

/// Statements that are kept.
#[derive(Default)]
pub(super) struct Statements {
    groups: Vec<Group>,
    /// Why one of them could not be bound.
    failed: Option<BoxDynError>,
}

/// Statements that go together, and what is bound to them.
#[derive(Default)]
pub(super) struct Group {
    statements: Vec<&'static str>,
    arguments: SqliteArguments,
}

impl Group {
    pub fn together(self) -> sqlx::query::Query<'static, Sqlite, SqliteArguments> {
        // Put together of texts of this crate.
        sqlx::query_with(AssertSqlSafe(self.statements.join("; ")), self.arguments)
    }
}

impl Statements {
    /// Keeps a statement. Parameters of statements that go together are counted through, so they have no numbers.
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

    /// Sends all of them; nothing if there are none.
    pub async fn send(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        if let Some(last) = self.send_but_the_last(connection).await? {
            connection.execute(last.together()).await?;
        }
        Ok(())
    }

    /// Whether all of them could be bound; to be asked before anything is sent.
    pub fn check(&mut self) -> Result<(), StoreError> {
        match self.failed.take() {
            Some(error) => Err(sqlx::Error::Encode(error).into()),
            None => Ok(()),
        }
    }

    /// Sends all but the last that go together.
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
