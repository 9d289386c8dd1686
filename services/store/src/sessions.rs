//! Sessions of people who have signed in with a browser, and the one-time codes that begin them.
//!
//! A session has the rights of the token with which it began: it refers to the token's row, and the database
//! deletes it with that row. The browser keeps a secret with as much entropy as a token; only its hash is
//! stored.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::{AuditAction, Session, SessionCode, SessionId, Timestamp};

use crate::actor::Actor;
use crate::audit::{Deed, note, note_only};
use crate::columns::{Id, Json, Time, Word};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::tokens::{self, Principal};
use crate::writing::run;

/// How long a one-time code is valid: five minutes, in microseconds.
const CODE_VALID: i64 = 300_000_000;

/// A session's last use is written at most once in this time: a minute, in microseconds.
const USE_NOTED: i64 = 60_000_000;

/// A session that has just begun.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NewSession {
    /// What the browser has to send. It is shown once; the database stores its hash.
    pub secret: String,
    /// The session.
    pub session: Session,
}

struct Row {
    id: Id,
    created_at: Time,
    expires_at: Time,
    last_used_at: Time,
    role: Word<forelight_protocol::Role>,
    projects: Option<Json<std::collections::BTreeMap<String, forelight_protocol::Role>>>,
    name: String,
}

impl From<Row> for Session {
    fn from(row: Row) -> Self {
        Session {
            id: Some(row.id.into()),
            role: row.role.0,
            projects: row.projects.map(|it| it.0),
            name: row.name,
            created_at: Some(row.created_at.into()),
            expires_at: Some(row.expires_at.into()),
            last_used_at: Some(row.last_used_at.into()),
        }
    }
}

/// Rows of sessions: `rows!("WHERE s.id = ?", session.0)`.
macro_rules! rows {
    ($rest:literal $(, $value:expr)* $(,)?) => {
        sqlx::query_as!(
            Row,
            "SELECT s.id, s.created_at, s.expires_at, s.last_used_at, t.role, t.projects, t.name FROM sessions s \
             JOIN tokens t ON t.hash = s.token_hash "
                + $rest
            $(, $value)*
        )
    };
}

impl Store {
    /// Makes a one-time code that begins a session with the rights of this caller.
    pub async fn create_session_code(&self, caller: &Principal, now: Timestamp) -> Result<SessionCode> {
        let code = tokens::random();
        let expires_at = now.plus_micros(CODE_VALID);
        let mut write = self.write().await?;
        run!(
            write,
            "INSERT INTO session_codes (hash, token_hash, expires_at) VALUES (?, ?, ?)",
            &tokens::hash(&code)[..],
            &caller.token[..],
            expires_at.micros()
        );
        self.commit(write).await?;
        Ok(SessionCode { code, expires_at })
    }

    /// Begins a session with a one-time code, which is used up. `None` if the code is unknown, used or
    /// expired.
    pub async fn begin_session_with_code(
        &self,
        code: &str,
        from: Option<IpAddr>,
        lifetime: Duration,
        now: Timestamp,
    ) -> Result<Option<NewSession>> {
        let hash = tokens::hash(code);
        let mut write = self.write().await?;
        let row = sqlx::query!(
            "SELECT c.token_hash, t.id AS \"token_id!: Id\", t.role, t.name FROM session_codes c JOIN tokens t ON t.hash = c.token_hash \
             WHERE c.hash = ?1 AND c.expires_at > ?2 AND (t.expires_at IS NULL OR t.expires_at > ?2)",
            &hash[..],
            now.micros()
        )
        .fetch_optional(write.connection().await?)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let actor = Actor { name: row.name, role: row.role.0, token: Some(row.token_id.into()), from };
        let mut write = write.by(Some(Arc::new(actor)));
        run!(write, "DELETE FROM session_codes WHERE hash = ?", &hash[..]);
        let session = begin(&mut write, &row.token_hash.0.0, lifetime, now).await?;
        self.commit(write).await?;
        Ok(Some(session))
    }

    /// Begins a session with the rights of the caller's token.
    pub async fn begin_session(
        &self,
        caller: &Principal,
        lifetime: Duration,
        now: Timestamp,
    ) -> Result<NewSession> {
        let mut write = self.write().await?;
        let session = begin(&mut write, &caller.token, lifetime, now).await?;
        self.commit(write).await?;
        Ok(session)
    }

    /// The caller with this secret of a session; `None` if it is unknown or has ended.
    pub async fn caller_of_session(&self, secret: &str, now: Timestamp) -> Result<Option<Principal>> {
        let hash = tokens::hash(secret);
        let row = sqlx::query!(
            "SELECT s.id, s.token_hash, s.last_used_at, t.id AS \"token_id!: Id\", t.role, t.projects, t.name, t.node_id, \
             min(s.expires_at, coalesce(t.expires_at, s.expires_at)) AS \"ends_at!: Time\" FROM sessions s \
             JOIN tokens t ON t.hash = s.token_hash WHERE s.secret_hash = ?1 AND s.expires_at > ?2 \
             AND (t.expires_at IS NULL OR t.expires_at > ?2)",
            &hash[..],
            now.micros()
        )
        .fetch_optional(self.readers())
        .await?;
        let Some(row) = row else { return Ok(None) };
        let id = SessionId::from(row.id);
        if now.micros_since(row.last_used_at.into()) >= USE_NOTED
            && let Err(error) = self.note_use(id, now).await
        {
            // Reading goes on while the disk is full.
            tracing::debug!(%error, "the use of a session was not noted");
        }
        Ok(Some(Principal {
            role: row.role.0,
            projects: row.projects.map(|it| it.0),
            name: row.name,
            hash,
            token: row.token_hash.0.0,
            session: Some(id),
            node: row.node_id.map(Into::into),
            token_id: row.token_id.into(),
            expires_at: Some(row.ends_at.into()),
            from: None,
        }))
    }

    async fn note_use(&self, session: SessionId, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        run!(write, "UPDATE sessions SET last_used_at = ? WHERE id = ?", now.micros(), session.0);
        self.commit(write).await
    }

    /// A session that has not ended.
    pub async fn session(&self, session: SessionId, now: Timestamp) -> Result<Session> {
        let row = rows!("WHERE s.id = ? AND s.expires_at > ?", session.0, now.micros());
        let row = row.fetch_optional(self.readers()).await?;
        Ok(row.ok_or(StoreError::NotFound("session"))?.into())
    }

    /// The sessions that have not ended and began before `before`, newest first, at most `limit`.
    pub async fn sessions(
        &self,
        before: Option<SessionId>,
        limit: u32,
        now: Timestamp,
    ) -> Result<Vec<Session>> {
        let before = before.map_or(uuid::Uuid::max(), |session| session.0);
        let rows = rows!(
            "WHERE s.id < ? AND s.expires_at > ? ORDER BY s.id DESC LIMIT ?",
            before,
            now.micros(),
            limit
        );
        Ok(rows.fetch_all(self.readers()).await?.into_iter().map(Session::from).collect())
    }

    /// Ends a session. [`StoreError::NotFound`] if it has ended before.
    pub async fn end_session(&self, session: SessionId, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        if run!(write, "DELETE FROM sessions WHERE id = ?", session.0) == 0 {
            return Err(StoreError::NotFound("session"));
        }
        note_only(&mut write, Deed::new(AuditAction::SessionEnded, session), now);
        self.commit(write).await
    }
}

pub(crate) async fn begin(
    write: &mut Write,
    token: &[u8; 32],
    lifetime: Duration,
    now: Timestamp,
) -> Result<NewSession> {
    let (secret, id) = (tokens::random(), SessionId::new());
    let expires_at = now.plus_micros(i64::try_from(lifetime.as_micros()).unwrap_or(i64::MAX));
    run!(
        write,
        "INSERT INTO sessions (id, secret_hash, token_hash, created_at, expires_at, last_used_at) \
         VALUES (?1, ?2, ?3, ?4, ?5, ?4)",
        id.0,
        &tokens::hash(&secret)[..],
        &token[..],
        now.micros(),
        expires_at.micros()
    );
    let row = rows!("WHERE s.id = ?", id.0).fetch_one(write.connection().await?).await?;
    let session = Session::from(row);
    let detail = serde_json::json!({"name": session.name, "role": session.role});
    note(write, Deed::new(AuditAction::SessionBegun, id), Some(&detail), now);
    Ok(NewSession { secret, session })
}

/// Deletes sessions and codes that have ended.
pub(crate) async fn forget_ended_sessions(write: &mut Write, now: Timestamp) -> Result<()> {
    run!(write, "DELETE FROM sessions WHERE expires_at <= ?", now.micros());
    run!(write, "DELETE FROM session_codes WHERE expires_at <= ?", now.micros());
    Ok(())
}
