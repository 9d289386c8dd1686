//! Bearer tokens.
//!
//! A token is dead as soon as its row is gone, or its time is over: every request looks for it in the
//! database. Requests that take long, such as streams of events, are told by `rights`.

use std::collections::BTreeMap;
use std::net::IpAddr;

use forelight_protocol::{
    AuditAction, NewToken, NodeId, Role, SessionId, Timestamp, Token, TokenChange, TokenId, TokenKind,
    TokenRequest,
};
use uuid::Uuid;

use crate::actor::Actor;
use crate::audit::{Deed, note};
use crate::columns::{Id, Json, Time, Word};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::projects::check_exists;
use crate::reach::{ALL_PROJECTS, highest};
use crate::writing::{later, run};

/// A token that expired is listed for so long: thirty days, in microseconds.
const LISTED_AFTER_ITS_END: i64 = 30 * 86_400_000_000;

/// The caller of a request.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Principal {
    /// What the token allows in all projects, or the most that it allows in one of `projects`.
    pub role: Role,
    /// The projects that the caller reaches, with a role in each; `None` for all, see `reach`.
    pub projects: Option<BTreeMap<String, Role>>,
    /// The token's name.
    pub name: String,
    /// BLAKE3 hash of the token, or of the session's secret. Idempotency keys belong to it.
    pub hash: [u8; 32],
    /// BLAKE3 hash of the token, also of the one with which a session began.
    pub token: [u8; 32],
    /// The session, if the caller has one.
    pub session: Option<SessionId>,
    /// The node that the token belongs to, if any.
    pub node: Option<NodeId>,
    /// The token's id.
    pub token_id: TokenId,
    /// When the right ends by itself.
    pub expires_at: Option<Timestamp>,
    /// Address from which the request came, if that is known.
    pub from: Option<IpAddr>,
}

impl Principal {
    /// The caller as the audit names him.
    pub fn actor(&self) -> Actor {
        Actor { name: self.name.clone(), role: self.role, token: Some(self.token_id), from: self.from }
    }
}

/// A new token.
///
/// It is `forelight_` and 64 hexadecimal digits: two UUIDs of version 4, 244 random bits from the operating
/// system. With that much entropy, a fast hash cannot be inverted by guessing, so no slow password hash is
/// needed.
pub fn random() -> String {
    format!("forelight_{}{}", Uuid::new_v4().simple(), Uuid::new_v4().simple())
}

/// The BLAKE3 hash of a token or of a session's secret. Only hashes are stored.
pub fn hash(secret: &str) -> [u8; 32] {
    *blake3::hash(secret.as_bytes()).as_bytes()
}

/// Makes a token without an end and returns it once: the database stores its hash. `name` is for people, 1 to
/// 200 characters.
pub async fn create(store: &Store, role: Role, name: &str, now: Timestamp) -> Result<String> {
    let request = for_all_projects(role, name);
    Ok(store.create_token(&request, now).await?.secret)
}

/// The caller with this token; `None` if the token is unknown or has expired. The lookup is by hash, so its
/// timing reveals nothing about the token.
pub async fn find(store: &Store, token: &str, now: Timestamp) -> Result<Option<Principal>> {
    let hash = hash(token);
    let row = sqlx::query!(
        "SELECT id AS \"id!: Id\", role, projects, name, node_id, expires_at FROM tokens WHERE hash = ? \
         AND (expires_at IS NULL OR expires_at > ?)",
        &hash[..],
        now.micros()
    )
    .fetch_optional(store.readers())
    .await?;
    Ok(row.map(|row| Principal {
        role: row.role.0,
        projects: row.projects.map(|it| it.0),
        name: row.name,
        hash,
        token: hash,
        session: None,
        node: row.node_id.map(Into::into),
        token_id: row.id.into(),
        expires_at: row.expires_at.map(Into::into),
        from: None,
    }))
}

/// How many tokens there are.
pub async fn count(store: &Store) -> Result<u64> {
    let count = sqlx::query_scalar!("SELECT count(*) FROM tokens").fetch_one(store.readers()).await?;
    Ok(count.unsigned_abs())
}

struct Row {
    id: Id,
    name: String,
    kind: Word<TokenKind>,
    role: Word<Role>,
    projects: Option<Json<BTreeMap<String, Role>>>,
    node_id: Option<Id>,
    created_at: Time,
    expires_at: Option<Time>,
    last_used_at: Option<Time>,
}

impl From<Row> for Token {
    fn from(row: Row) -> Self {
        Token {
            id: row.id.into(),
            name: row.name,
            kind: row.kind.0,
            role: row.role.0,
            projects: row.projects.map(|it| it.0),
            node_id: row.node_id.map(Into::into),
            created_at: row.created_at.into(),
            expires_at: row.expires_at.map(Into::into),
            last_used_at: row.last_used_at.map(Into::into),
        }
    }
}

/// Rows of tokens: `rows!("WHERE id = ?", token.0)`.
macro_rules! rows {
    ($rest:literal $(, $value:expr)* $(,)?) => {
        sqlx::query_as!(
            Row,
            "SELECT id AS \"id!: Id\", name, kind, role, projects, node_id, created_at, expires_at, last_used_at FROM tokens " + $rest
            $(, $value)*
        )
    };
}

impl Store {
    /// Makes a token. Its secret is returned once: the database stores its hash.
    pub async fn create_token(&self, request: &TokenRequest, now: Timestamp) -> Result<NewToken> {
        let mut write = self.write().await?;
        let new = insert(&mut write, request, now).await?;
        note(&mut write, Deed::new(AuditAction::TokenCreated, new.token.id), Some(request), now);
        self.commit(write).await?;
        Ok(new)
    }

    /// Makes the token of a role that a service writes into its folder when it starts. It replaces the one
    /// that an earlier start made.
    pub async fn create_first_token(&self, role: Role, now: Timestamp) -> Result<String> {
        let name = format!("first {role}");
        let request = TokenRequest { kind: TokenKind::Service, ..for_all_projects(role, &name) };
        let mut write = self.write().await?;
        run!(write, "DELETE FROM tokens WHERE first = 1 AND role = ?", role.name());
        let new = insert(&mut write, &request, now).await?;
        run!(write, "UPDATE tokens SET first = 1 WHERE id = ?", new.token.id.0);
        self.commit(write).await?;
        Ok(new.secret)
    }

    /// A token.
    pub async fn token(&self, token: TokenId) -> Result<Token> {
        let row = rows!("WHERE id = ?", token.0).fetch_optional(self.readers()).await?;
        Ok(row.ok_or(StoreError::NotFound("token"))?.into())
    }

    /// The tokens made after this one, oldest first, at most `limit`.
    pub async fn tokens(&self, after: Option<(Timestamp, TokenId)>, limit: u32) -> Result<Vec<Token>> {
        let (at, id) = after.map_or((i64::MIN, Uuid::nil()), |(at, id)| (at.micros(), id.0));
        let rows = rows!("WHERE (created_at, id) > (?, ?) ORDER BY created_at, id LIMIT ?", at, id, limit);
        Ok(rows.fetch_all(self.readers()).await?.into_iter().map(Token::from).collect())
    }

    /// Changes a token's name or end.
    pub async fn change_token(&self, token: TokenId, change: &TokenChange, now: Timestamp) -> Result<Token> {
        let mut write = self.write().await?;
        if let Some(name) = &change.name {
            run!(write, "UPDATE tokens SET name = ? WHERE id = ?", name, token.0);
        }
        if let Some(end) = change.expires_at {
            run!(write, "UPDATE tokens SET expires_at = ? WHERE id = ?", end.map(Timestamp::micros), token.0);
        }
        if let Some(projects) = &change.projects {
            check_projects(&mut write, projects).await?;
            let set = run!(
                write,
                "UPDATE tokens SET projects = ?, role = ? WHERE id = ? AND projects IS NOT NULL",
                Json(projects),
                highest(projects).name(),
                token.0
            );
            if set == 0 {
                read(&mut write, token).await?;
                let reason = "the token reaches all projects; make another one that reaches some";
                return Err(StoreError::Conflict(reason.to_owned()));
            }
        }
        let changed = read(&mut write, token).await?;
        note(&mut write, Deed::new(AuditAction::TokenChanged, token), Some(change), now);
        self.commit(write).await?;
        Ok(changed)
    }

    /// Replaces a token by a new one with the same rights. The old one is valid for `grace` microseconds
    /// more.
    pub async fn rotate_token(&self, token: TokenId, grace: i64, now: Timestamp) -> Result<NewToken> {
        let (secret, new) = (random(), TokenId::new());
        let mut write = self.write().await?;
        let old = read(&mut write, token).await?;
        if let Some(end) = old.expires_at.filter(|end| *end <= now) {
            return Err(StoreError::Conflict(format!("the token expired at {end}; make a new one")));
        }
        run!(
            write,
            "INSERT INTO tokens (hash, id, name, kind, role, projects, node_id, first, created_at, expires_at) \
             SELECT ?, ?, name, kind, role, projects, node_id, first, ?, expires_at FROM tokens WHERE id = ?",
            &hash(&secret)[..],
            new.0,
            now.micros(),
            token.0
        );
        if grace > 0 {
            run!(
                write,
                "UPDATE tokens SET first = 0, expires_at = min(coalesce(expires_at, ?1), ?1) WHERE id = ?2",
                now.plus_micros(grace).micros(),
                token.0
            );
        } else {
            run!(write, "DELETE FROM tokens WHERE id = ?", token.0);
        }
        let made = read(&mut write, new).await?;
        let detail = serde_json::json!({"name": made.name, "successor": new, "grace_micros": grace});
        note(&mut write, Deed::new(AuditAction::TokenRotated, token), Some(&detail), now);
        self.commit(write).await?;
        Ok(NewToken { secret, token: made })
    }

    /// Revokes a token, and ends its sessions.
    pub async fn revoke_token(&self, token: TokenId, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        let Token { name, .. } = read(&mut write, token).await?;
        run!(write, "DELETE FROM tokens WHERE id = ?", token.0);
        let detail = serde_json::json!({"name": name});
        note(&mut write, Deed::new(AuditAction::TokenRevoked, token), Some(&detail), now);
        self.commit(write).await
    }

    /// Notes when tokens were last used, by their hashes.
    pub async fn note_tokens_used(&self, used: &[([u8; 32], Timestamp)]) -> Result<()> {
        if used.is_empty() {
            return Ok(());
        }
        let mut write = self.write().await?;
        for (hash, at) in used {
            later!(write, "UPDATE tokens SET last_used_at = ? WHERE hash = ?", at.micros(), &hash[..]);
        }
        self.commit(write).await
    }
}

fn for_all_projects(role: Role, name: &str) -> TokenRequest {
    let kind = if role == Role::Worker { TokenKind::Service } else { TokenKind::Person };
    TokenRequest { name: name.to_owned(), kind, role: Some(role), projects: None, expires_at: None }
}

/// The first of these projects that does not exist is a [`StoreError::NoProject`].
async fn check_projects(write: &mut Write, projects: &BTreeMap<String, Role>) -> Result<()> {
    for project in projects.keys().filter(|project| *project != ALL_PROJECTS) {
        check_exists(write.connection().await?, project).await?;
    }
    Ok(())
}

async fn insert(write: &mut Write, request: &TokenRequest, now: Timestamp) -> Result<NewToken> {
    let (secret, id) = (random(), TokenId::new());
    let role = match &request.projects {
        Some(projects) => {
            check_projects(write, projects).await?;
            highest(projects)
        }
        None => request.role.unwrap_or(Role::Viewer),
    };
    run!(
        write,
        "INSERT INTO tokens (hash, id, name, kind, role, projects, created_at, expires_at) \
         VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        &hash(&secret)[..],
        id.0,
        request.name,
        request.kind.name(),
        role.name(),
        request.projects.as_ref().map(Json),
        now.micros(),
        request.expires_at.map(Timestamp::micros)
    );
    Ok(NewToken { secret, token: read(write, id).await? })
}

async fn read(write: &mut Write, token: TokenId) -> Result<Token> {
    let row = rows!("WHERE id = ?", token.0).fetch_optional(write.connection().await?).await?;
    Ok(row.ok_or(StoreError::NotFound("token"))?.into())
}

/// Deletes tokens that expired long ago.
pub(crate) async fn forget_expired_tokens(write: &mut Write, now: Timestamp) -> Result<()> {
    run!(write, "DELETE FROM tokens WHERE expires_at <= ?", now.plus_micros(-LISTED_AFTER_ITS_END).micros());
    Ok(())
}
