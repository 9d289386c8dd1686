//! Machines that join the farm with a one-time token.
//!
//! The machine makes its own bearer token and sends its hash with the one-time token, which is burnt in the same transaction that makes
//! the node and its token. Three hazards are met by that: an answer that is lost (the machine asks again with the same hash, and is
//! answered as before), a one-time token that someone else picked up (it is good for one hash alone, and both notice), and a machine
//! that calls itself as another does (it takes that one's place only with a token that was made in its name).

use forelight_protocol::{ArtifactHash, JoinRequest, JoinToken, Node, Timestamp};

use crate::database::Store;
use crate::error::StoreError;
use crate::{nodes, tokens};

impl Store {
    /// Makes a one-time token that is valid for so many microseconds from `now`.
    pub async fn create_join_token(
        &self,
        name: &str,
        valid_micros: i64,
        now: Timestamp,
    ) -> Result<JoinToken, StoreError> {
        let token = tokens::random();
        let expires_at = now.plus_micros(valid_micros);
        let mut write = self.write().await?;
        // Long expired ones are of no use to anyone, unless they say which node came by them.
        sqlx::query!("DELETE FROM join_tokens WHERE expires_at < ? AND used_at IS NULL", now.micros())
            .execute(write.connection().await?)
            .await?;
        sqlx::query!(
            "INSERT INTO join_tokens (hash, name, created_at, expires_at) VALUES (?, ?, ?, ?)",
            &tokens::hash(&token)[..],
            name,
            now.micros(),
            expires_at.micros()
        )
        .execute(write.connection().await?)
        .await?;
        self.commit(write).await?;
        Ok(JoinToken { token, expires_at })
    }

    /// Burns a one-time token: makes the node, and lets the token with the hash that the machine chose speak for it.
    pub async fn join(&self, token: &str, request: &JoinRequest, now: Timestamp) -> Result<Node, StoreError> {
        let burnt = tokens::hash(token);
        let mut write = self.write().await?;
        let row = sqlx::query!(
            "SELECT name, expires_at, used_at, used_for, node_id FROM join_tokens WHERE hash = ?",
            &burnt[..]
        )
        .fetch_optional(write.connection().await?)
        .await?
        .ok_or_else(|| StoreError::JoinRefused("this one-time token is not known here".to_owned()))?;
        if let (Some(node), Some(chosen)) = (row.node_id, row.used_for.map(ArtifactHash::from)) {
            let node = nodes::read(write.connection().await?, node.into()).await?;
            if chosen == request.token_hash && node.name == request.node.name {
                return Ok(node);
            }
            if chosen == request.token_hash {
                return Err(StoreError::Conflict(format!(
                    "this machine joined as the node {:?} with this one-time token; join under that name, or ask an operator for a new token",
                    node.name
                )));
            }
            let used_at = row.used_at.map_or(String::new(), |at| format!(" at {}", Timestamp::from(at)));
            return Err(StoreError::Conflict(format!(
                "this one-time token was used{used_at} by another machine; ask an operator for a new one, and if nobody knows that machine, \
                 have its node removed from service"
            )));
        }
        let expires_at = Timestamp::from(row.expires_at);
        if expires_at <= now {
            return Err(StoreError::JoinRefused(format!(
                "this one-time token expired at {expires_at}; ask an operator for a new one"
            )));
        }
        let made_for = row.name;
        let taken = nodes::by_name(write.connection().await?, &request.node.name).await?.is_some();
        if taken && made_for != request.node.name {
            return Err(StoreError::Conflict(format!(
                "there is a node {0:?} already, and this one-time token was made for {made_for:?}: join under another name, or, if this \
                 machine is to take that node's place, with a one-time token whose name is {0:?}",
                request.node.name
            )));
        }
        let node = nodes::changing::upsert(&mut write, &request.node, now).await?;
        sqlx::query!(
            "UPDATE join_tokens SET used_at = ?, used_for = ?, node_id = ? WHERE hash = ?",
            now.micros(),
            &request.token_hash.0[..],
            node.id.0,
            &burnt[..]
        )
        .execute(write.connection().await?)
        .await?;
        // A machine that takes another's place takes its token away.
        sqlx::query!("DELETE FROM tokens WHERE node_id = ?", node.id.0)
            .execute(write.connection().await?)
            .await?;
        let inserted = sqlx::query!(
            "INSERT INTO tokens (hash, name, role, created_at, node_id) VALUES (?, ?, 'worker', ?, ?) \
             ON CONFLICT DO NOTHING",
            &request.token_hash.0[..],
            node.name,
            now.micros(),
            node.id.0
        )
        .execute(write.connection().await?)
        .await?;
        if inserted.rows_affected() == 0 {
            return Err(StoreError::Conflict("the hash is that of a token which is in use".to_owned()));
        }
        self.commit(write).await?;
        Ok(node)
    }
}

/// The hash of a token that a machine made for itself.
pub fn token_hash(token: &str) -> ArtifactHash {
    ArtifactHash(tokens::hash(token))
}
