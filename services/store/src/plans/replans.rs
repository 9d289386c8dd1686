//! New plans that are due: what has happened since the newest plan.
//!
//! Each cause is counted in the transaction in which it happens. The planner reads the count first and the
//! farm's state after it, and stores the count with its plan. Causes that come in meanwhile stay due. So a
//! burst leads to one plan, the newest state wins, and a crash loses nothing.

use sqlx::SqliteConnection;

use crate::columns::Json;
use crate::database::{Store, Write};
use crate::error::Result;
use crate::policy::replans::{add_cause, causes_left};
use crate::writing::run;

/// The causes that a new plan has to take into account.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Wanted {
    /// Number of causes so far, ever.
    pub count: i64,
    /// Causes since the newest plan, one line each.
    pub causes: Vec<String>,
    /// Whether there are any.
    pub due: bool,
}

impl Store {
    /// The causes that no plan has taken into account yet.
    pub async fn wanted_plan(&self) -> Result<Wanted> {
        read(&mut *self.readers().acquire().await?).await
    }

    /// Asks for a new plan.
    pub async fn want_plan(&self, cause: &str) -> Result<()> {
        let mut write = self.write().await?;
        want(&mut write, cause).await?;
        self.commit(write).await
    }

    /// Records that planning up to this count found nothing to change.
    pub async fn plan_still_good(&self, wanted: &Wanted) -> Result<()> {
        let mut write = self.write().await?;
        planned(&mut write, wanted).await?;
        self.commit(write).await
    }
}

async fn read(connection: &mut SqliteConnection) -> Result<Wanted> {
    let row = sqlx::query!("SELECT wanted, planned, causes FROM replans").fetch_one(connection).await?;
    Ok(Wanted { count: row.wanted, causes: row.causes.0, due: row.wanted > row.planned })
}

/// Records a cause inside a write. The same cause is kept once.
pub(crate) async fn want(write: &mut Write, cause: &str) -> Result<()> {
    let mut causes = read(write.connection().await?).await?.causes;
    add_cause(&mut causes, cause);
    run!(write, "UPDATE replans SET wanted = wanted + 1, causes = ?", Json(&causes));
    write.wants_plan = true;
    Ok(())
}

/// Records inside a write that these causes were taken into account.
pub(crate) async fn planned(write: &mut Write, wanted: &Wanted) -> Result<()> {
    let now = read(write.connection().await?).await?;
    let rest = causes_left(&now.causes, now.count, wanted.count, wanted.causes.len());
    run!(write, "UPDATE replans SET planned = max(planned, ?), causes = ?", wanted.count, Json(rest));
    Ok(())
}
