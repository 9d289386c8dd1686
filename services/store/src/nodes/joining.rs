//! Machines that join the farm with a one-time token.
//!
//! The machine makes its own bearer token and sends its hash with the one-time token. One transaction uses
//! the one-time token up and makes the node and its token. This meets three hazards:
//!
//! * The answer is lost: the machine asks again with the same hash and gets the same answer.
//! * Someone else finds the one-time token: it works for one hash only, and both machines notice.
//! * A machine uses another machine's name: it replaces that node only with a one-time token made for the
//!   name.

use std::net::IpAddr;
use std::sync::Arc;

use forelight_protocol::{
    ArtifactHash, AuditAction, JoinRequest, JoinToken, Node, NodeId, Role, Timestamp, TokenId,
};

use crate::actor::Actor;
use crate::audit::{Deed, note, note_only};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::writing::run;
use crate::{nodes, tokens};

const REMOVED: &str =
    "the node that joined with this one-time token was removed; ask an operator for a new one";

impl Store {
    /// Makes a one-time token that is valid for so many microseconds from `now`.
    pub async fn create_join_token(
        &self,
        name: &str,
        valid_micros: i64,
        now: Timestamp,
    ) -> Result<JoinToken> {
        let token = tokens::random();
        let expires_at = now.plus_micros(valid_micros);
        let mut write = self.write().await?;
        // Expired unused tokens go. Used ones stay, because they record which node used them.
        run!(write, "DELETE FROM join_tokens WHERE expires_at < ? AND used_at IS NULL", now.micros());
        run!(
            write,
            "INSERT INTO join_tokens (hash, name, created_at, expires_at) VALUES (?, ?, ?, ?)",
            &tokens::hash(&token)[..],
            name,
            now.micros(),
            expires_at.micros()
        );
        note_only(&mut write, Deed::new(AuditAction::JoinTokenCreated, name), now);
        self.commit(write).await?;
        Ok(JoinToken { token, expires_at })
    }

    /// Uses a one-time token up: makes the node, and its bearer token with the hash that the machine chose.
    pub async fn join(
        &self,
        token: &str,
        request: &JoinRequest,
        from: Option<IpAddr>,
        now: Timestamp,
    ) -> Result<Node> {
        let burnt = tokens::hash(token);
        let mut write = self.write().await?;
        let row = sqlx::query!(
            "SELECT name, expires_at, used_at, used_for, node_id FROM join_tokens WHERE hash = ?",
            &burnt[..]
        )
        .fetch_optional(write.connection().await?)
        .await?
        .ok_or_else(|| StoreError::JoinRefused("this one-time token is unknown".to_owned()))?;
        if let (Some(node), Some(chosen)) = (row.node_id, row.used_for.map(ArtifactHash::from)) {
            let used_at = row.used_at.map(Timestamp::from);
            return joined_before(&mut write, node.into(), (chosen, used_at), request).await;
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
                "there is already a node {0:?}, and this one-time token was made for {made_for:?}; \
                 join under another name, or, to replace that node, with a one-time token made for {0:?}",
                request.node.name
            )));
        }
        let node = nodes::changing::upsert(&mut write, &request.node, now).await?;
        run!(
            write,
            "UPDATE join_tokens SET used_at = ?, used_for = ?, node_id = ? WHERE hash = ?",
            now.micros(),
            &request.token_hash.0[..],
            node.id.0,
            &burnt[..]
        );
        // A machine that replaces another one also revokes its token.
        run!(write, "DELETE FROM tokens WHERE node_id = ?", node.id.0);
        let inserted = run!(
            write,
            "INSERT INTO tokens (hash, id, name, kind, role, created_at, node_id) \
             VALUES (?, ?, ?, 'service', 'worker', ?, ?) \
             ON CONFLICT DO NOTHING",
            &request.token_hash.0[..],
            TokenId::new().0,
            node.name,
            now.micros(),
            node.id.0
        );
        if inserted == 0 {
            return Err(StoreError::Conflict("the hash belongs to a token that is in use".to_owned()));
        }
        let actor = Actor { name: made_for, role: Role::Worker, token: None, from };
        let mut write = write.by(Some(Arc::new(actor)));
        let detail = serde_json::json!({"name": node.name});
        note(&mut write, Deed::new(AuditAction::NodeJoined, node.id), Some(&detail), now);
        self.commit(write).await?;
        Ok(node)
    }
}

/// The answer to a one-time token that was used: the node, if the same machine asks again.
async fn joined_before(
    write: &mut Write,
    node: NodeId,
    (chosen, used_at): (ArtifactHash, Option<Timestamp>),
    request: &JoinRequest,
) -> Result<Node> {
    let node = match nodes::read(write.connection().await?, node).await {
        Err(StoreError::NotFound(_)) => return Err(StoreError::JoinRefused(REMOVED.to_owned())),
        node => node?,
    };
    if chosen == request.token_hash && node.name == request.node.name {
        return Ok(node);
    }
    if chosen == request.token_hash {
        return Err(StoreError::Conflict(format!(
            "this machine joined as the node {:?} with this one-time token; join under that name, \
             or ask an operator for a new token",
            node.name
        )));
    }
    let used_at = used_at.map_or(String::new(), |at| format!(" at {at}"));
    Err(StoreError::Conflict(format!(
        "this one-time token was used{used_at} by another machine; ask an operator for a new one, \
         and to take that machine's node out of service if it is unknown"
    )))
}

/// The hash of a token that a machine made for itself.
pub fn token_hash(token: &str) -> ArtifactHash {
    ArtifactHash(tokens::hash(token))
}
