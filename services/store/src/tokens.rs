//! Bearer tokens.

use forelight_protocol::{NodeId, Role, SessionId, Timestamp};
use uuid::Uuid;

use crate::database::Store;
use crate::error::Result;
use crate::writing::run;

/// The caller of a request.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Principal {
    /// What the token allows.
    pub role: Role,
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
}

/// A new token.
///
/// It is `forelight_` and 64 hexadecimal digits: two UUIDs of version 4, 244 random bits from the operating
/// system. With that much entropy, a fast hash cannot be inverted by guessing, so no slow password hash is
/// needed.
pub fn random() -> String {
    format!("forelight_{}{}", Uuid::new_v4().simple(), Uuid::new_v4().simple())
}

/// Makes a token and returns it once: the database stores its hash. `name` is for people, 1 to 200
/// characters.
pub async fn create(store: &Store, role: Role, name: &str, now: Timestamp) -> Result<String> {
    let token = random();
    let mut write = store.write().await?;
    run!(
        write,
        "INSERT INTO tokens (hash, name, role, created_at) VALUES (?, ?, ?, ?)",
        &hash(&token)[..],
        name,
        role.name(),
        now.micros()
    );
    store.commit(write).await?;
    Ok(token)
}

/// The caller with this token; `None` if the token is unknown. The lookup is by hash, so its timing reveals
/// nothing about the token.
pub async fn find(store: &Store, token: &str) -> Result<Option<Principal>> {
    let hash = hash(token);
    let row = sqlx::query!("SELECT role, name, node_id FROM tokens WHERE hash = ?", &hash[..])
        .fetch_optional(store.readers())
        .await?;
    Ok(row.map(|row| {
        let node = row.node_id.map(Into::into);
        Principal { role: row.role.0, name: row.name, hash, token: hash, session: None, node }
    }))
}

/// How many tokens there are.
pub async fn count(store: &Store) -> Result<u64> {
    let count = sqlx::query_scalar!("SELECT count(*) FROM tokens").fetch_one(store.readers()).await?;
    Ok(count.unsigned_abs())
}

pub(crate) fn hash(token: &str) -> [u8; 32] {
    *blake3::hash(token.as_bytes()).as_bytes()
}
