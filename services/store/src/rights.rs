//! Rights that ended: tokens that were revoked, replaced or changed, and sessions that were ended.
//!
//! The database's triggers write them down in order, also for another process such as `forelight token`
//! beside a running service. So whoever follows this list misses none.

use forelight_protocol::Timestamp;

use crate::database::{Store, Write};
use crate::error::Result;
use crate::writing::run;

/// Number of rows that are kept for the service, which reads them within a second.
const KEPT: i64 = 10_000;

/// A right that ended, or ends at another time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EndedRight {
    /// Its place in the order.
    pub number: i64,
    /// BLAKE3 hash of the token, or of the session's secret.
    pub hash: [u8; 32],
    /// Whether it is over. If not, ask when it ends, see [`Store::end_of_right`].
    pub is_over: bool,
}

/// When a right ends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EndOfRight {
    /// It has ended, or never was.
    Over,
    /// It ends then, if ever.
    At(Option<Timestamp>),
}

impl Store {
    /// The rights that ended after this place, oldest first.
    pub async fn ended_rights(&self, after: i64) -> Result<Vec<EndedRight>> {
        let rows = sqlx::query!("SELECT id, hash, is_over FROM ended_rights WHERE id > ? ORDER BY id", after)
            .fetch_all(self.readers())
            .await?;
        let ended = |hash: crate::columns::Hash| hash.0.0;
        Ok(rows
            .into_iter()
            .map(|row| EndedRight { number: row.id, hash: ended(row.hash), is_over: row.is_over })
            .collect())
    }

    /// The newest place in the order; 0 if none has ended.
    pub async fn newest_ended_right(&self) -> Result<i64> {
        Ok(sqlx::query_scalar!(r#"SELECT coalesce(max(id), 0) AS "id!: i64" FROM ended_rights"#)
            .fetch_one(self.readers())
            .await?)
    }

    /// When the right with this hash ends by itself.
    pub async fn end_of_right(&self, hash: &[u8; 32]) -> Result<EndOfRight> {
        let end = sqlx::query_scalar!(
            r#"SELECT expires_at AS "at: crate::columns::Time" FROM tokens WHERE hash = ?1
               UNION ALL SELECT min(s.expires_at, coalesce(t.expires_at, s.expires_at))
               FROM sessions s JOIN tokens t ON t.hash = s.token_hash WHERE s.secret_hash = ?1"#,
            &hash[..]
        )
        .fetch_optional(self.readers())
        .await?;
        Ok(end.map_or(EndOfRight::Over, |end| EndOfRight::At(end.map(Into::into))))
    }
}

/// Deletes what the service has read long ago.
pub(crate) async fn forget_ended_rights(write: &mut Write) -> Result<()> {
    run!(
        write,
        "DELETE FROM ended_rights WHERE id <= (SELECT coalesce(max(id), 0) FROM ended_rights) - ?",
        KEPT
    );
    Ok(())
}
