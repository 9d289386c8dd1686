//! Plans that are due: what happened since the newest plan that has taken it into account.
//!
//! What calls for a new plan is counted in the transaction in which it happens. Whoever plans reads the count first and the farm's state
//! after it, and says with the plan how far it has counted: what happened meanwhile stays due. So bursts become one plan, the newest state wins, and
//! no death of the service in between loses anything.

use sqlx::SqliteConnection;

use crate::columns::Json;
use crate::database::Store;
use crate::database::Write;
use crate::error::StoreError;
use crate::policy::replans::{add_cause, causes_left};

/// What a plan would have to take into account.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Wanted {
    /// How often something happened, ever.
    pub count: i64,
    /// What happened since the newest plan, a line each.
    pub causes: Vec<String>,
    /// Whether anything did.
    pub due: bool,
}

impl Store {
    /// What happened that no plan has taken into account yet.
    pub async fn wanted_plan(&self) -> Result<Wanted, StoreError> {
        let mut connection = self.readers().acquire().await?;
        read(&mut connection).await
    }

    /// Asks for a new plan.
    pub async fn want_plan(&self, cause: &str) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        want(&mut write, cause).await?;
        self.commit(write).await
    }

    /// A plan was made of everything up to this count, and nothing had to be changed.
    pub async fn plan_still_good(&self, wanted: &Wanted) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        planned(&mut write, wanted).await?;
        self.commit(write).await
    }
}

async fn read(connection: &mut SqliteConnection) -> Result<Wanted, StoreError> {
    let row = sqlx::query!("SELECT wanted, planned, causes FROM replans").fetch_one(connection).await?;
    Ok(Wanted { count: row.wanted, causes: row.causes.0, due: row.wanted > row.planned })
}

/// Says inside a write that the newest plan does not know of this. The same cause is said once.
pub(crate) async fn want(write: &mut Write, cause: &str) -> Result<(), StoreError> {
    let mut causes = read(write.connection().await?).await?.causes;
    add_cause(&mut causes, cause);
    sqlx::query!("UPDATE replans SET wanted = wanted + 1, causes = ?", Json(&causes))
        .execute(write.connection().await?)
        .await?;
    write.wants_plan = true;
    Ok(())
}

/// Says inside a write that everything up to this has been taken into account.
pub(crate) async fn planned(write: &mut Write, wanted: &Wanted) -> Result<(), StoreError> {
    let now = read(write.connection().await?).await?;
    let rest = causes_left(&now.causes, now.count, wanted.count, wanted.causes.len());
    sqlx::query!("UPDATE replans SET planned = max(planned, ?), causes = ?", wanted.count, Json(rest))
        .execute(write.connection().await?)
        .await?;
    Ok(())
}
