//! Who did what: the audit.
//!
//! An entry is written in the transaction of the change that it is about, so there is never one without the
//! other. A write knows its actor: a store that acts for somebody ([`Store::acting_for`]) passes him on.

use forelight_protocol::{AuditAction, AuditEntry, Role, Timestamp};
use serde::Serialize;

use crate::columns::{Id, Json, Time, Word, corrupt};
use crate::database::{Store, Write};
use crate::error::Result;
use crate::writing::later;

/// The name in entries about what was done beside the service, as by `forelight token`.
const THIS_MACHINE: &str = "this machine";

/// Which entries to list. Absent fields match all.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct AuditFilter {
    /// Who.
    pub actor: Option<String>,
    /// What was done.
    pub action: Option<AuditAction>,
    /// With what.
    pub target: Option<String>,
    /// The project.
    pub project: Option<String>,
    /// Not before this instant.
    pub from: Option<Timestamp>,
    /// Before this instant.
    pub to: Option<Timestamp>,
}

/// What was done, for an entry.
pub(crate) struct Deed<'a> {
    pub action: AuditAction,
    /// The id or name of what it was done with.
    pub target: String,
    pub project: Option<&'a str>,
}

impl<'a> Deed<'a> {
    pub fn new(action: AuditAction, target: impl ToString) -> Self {
        Self { action, target: target.to_string(), project: None }
    }

    pub fn of_project(self, project: &'a str) -> Self {
        Self { project: Some(project), ..self }
    }
}

/// Writes an entry inside the write that it is about. `detail` is what was asked for, without secrets.
pub(crate) fn note(write: &mut Write, deed: Deed<'_>, detail: Option<&impl Serialize>, now: Timestamp) {
    debug_assert!(
        detail.is_none_or(|detail| serde_json::to_value(detail).is_ok_and(|detail| detail.is_object())),
        "{} has a detail that is no object",
        deed.action.name()
    );
    let actor = write.actor();
    let actor = actor.as_deref();
    later!(
        write,
        "INSERT INTO audit (at, actor, role, token, peer, action, target, project, detail) \
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        now.micros(),
        actor.map_or(THIS_MACHINE, |actor| actor.name.as_str()),
        actor.map(|actor| actor.role.name()),
        actor.and_then(|actor| actor.token).map(|token| token.0),
        actor.and_then(|actor| actor.from).map(|from| from.to_string()),
        deed.action.name(),
        deed.target,
        deed.project,
        detail.map(Json)
    );
}

/// As [`note`], if there is nothing more to say.
pub(crate) fn note_only(write: &mut Write, deed: Deed<'_>, now: Timestamp) {
    note(write, deed, None::<&()>, now);
}

struct Row {
    id: i64,
    at: Time,
    actor: String,
    role: Option<Word<Role>>,
    token: Option<Id>,
    peer: Option<String>,
    action: String,
    target: String,
    project: Option<String>,
    detail: Option<Json<serde_json::Value>>,
}

impl TryFrom<Row> for AuditEntry {
    type Error = crate::StoreError;

    fn try_from(row: Row) -> Result<Self> {
        Ok(AuditEntry {
            id: row.id,
            at: row.at.into(),
            actor: row.actor,
            role: row.role.map(|role| role.0),
            token_id: row.token.map(Into::into),
            from: row.peer,
            action: row.action.parse().map_err(|error| corrupt("action", error))?,
            target: row.target,
            project: row.project,
            detail: row.detail.map(|detail| detail.0),
        })
    }
}

/// Rows of the audit: `?1` to `?6` are the filter, `?7` the place, `?8` the number of rows.
macro_rules! rows {
    ($store:expr, $filter:expr, $place:expr, $limit:expr, $order:literal) => {
        sqlx::query_as!(
            Row,
            "SELECT id, at, actor, role, token, peer, action, target, project, detail FROM audit \
             WHERE (?1 IS NULL OR actor = ?1) AND (?2 IS NULL OR action = ?2) AND (?3 IS NULL OR target = ?3) \
             AND (?4 IS NULL OR project = ?4) AND (?5 IS NULL OR at >= ?5) AND (?6 IS NULL OR at < ?6) AND "
                + $order,
            $filter.actor,
            $filter.action.map(AuditAction::name),
            $filter.target,
            $filter.project,
            $filter.from.map(Timestamp::micros),
            $filter.to.map(Timestamp::micros),
            $place,
            $limit
        )
        .fetch_all($store.readers())
        .await?
    };
}

impl Store {
    /// The entries before this one that match, newest first, at most `limit`.
    pub async fn audit(
        &self,
        filter: &AuditFilter,
        before: Option<i64>,
        limit: u32,
    ) -> Result<Vec<AuditEntry>> {
        let before = before.unwrap_or(i64::MAX);
        let rows = rows!(self, filter, before, limit, "id < ?7 ORDER BY id DESC LIMIT ?8");
        rows.into_iter().map(AuditEntry::try_from).collect()
    }

    /// The entries after this one that match, oldest first, at most `limit`.
    pub async fn audit_after(&self, filter: &AuditFilter, after: i64, limit: u32) -> Result<Vec<AuditEntry>> {
        let rows = rows!(self, filter, after, limit, "id > ?7 ORDER BY id LIMIT ?8");
        rows.into_iter().map(AuditEntry::try_from).collect()
    }
}
