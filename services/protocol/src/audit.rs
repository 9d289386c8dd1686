//! Who did what, when, and from where.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{PageToken, Role, Timestamp, TokenId};

macro_rules! actions {
    ($($(#[$doc:meta])* $name:ident = $word:literal),* $(,)?) => {
        /// What somebody did.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum AuditAction {
            $($(#[$doc])* $name),*
        }

        impl AuditAction {
            /// All actions.
            pub const ALL: &[AuditAction] = &[$(AuditAction::$name),*];

            /// The name, as in JSON.
            pub const fn name(self) -> &'static str {
                match self {
                    $(AuditAction::$name => $word),*
                }
            }
        }
    };
}
actions!(
    /// A job was submitted.
    JobSubmitted = "job_submitted",
    /// A job's terms were changed.
    JobChanged = "job_changed",
    /// The quote of a job on hold was accepted.
    JobAccepted = "job_accepted",
    /// A job was cancelled.
    JobCancelled = "job_cancelled",
    /// A job was deleted.
    JobDeleted = "job_deleted",
    /// A job was taken out of the track record.
    JobLeftOut = "job_left_out",
    /// A job that had been taken out of the track record counts again.
    JobCounted = "job_counted",
    /// Frames of a job are rendered again.
    FramesRetried = "frames_retried",
    /// Frames of a job were cancelled.
    FramesCancelled = "frames_cancelled",
    /// A bundle was uploaded.
    BundleUploaded = "bundle_uploaded",
    /// A node joined with a one-time token.
    NodeJoined = "node_joined",
    /// A node was given an order, or changed in another way.
    NodeChanged = "node_changed",
    /// A node was removed.
    NodeRemoved = "node_removed",
    /// A one-time token was made.
    JoinTokenCreated = "join_token_created",
    /// A token was made.
    TokenCreated = "token_created",
    /// A token was changed.
    TokenChanged = "token_changed",
    /// A token was replaced by a new one.
    TokenRotated = "token_rotated",
    /// A token was revoked.
    TokenRevoked = "token_revoked",
    /// Somebody signed in with a browser.
    SessionBegun = "session_begun",
    /// A session was ended.
    SessionEnded = "session_ended",
    /// A project was made, or its share was set.
    ProjectSet = "project_set",
    /// How long something is kept was set.
    RetentionSet = "retention_set",
    /// Entries of the audit that were past their time were deleted.
    AuditPruned = "audit_pruned",
    /// A quota was set, or removed.
    QuotaSet = "quota_set",
    /// A budget was set.
    BudgetSet = "budget_set",
    /// A budget was removed.
    BudgetRemoved = "budget_removed",
    /// A webhook was added.
    WebhookAdded = "webhook_added",
    /// A webhook was removed.
    WebhookRemoved = "webhook_removed",
);

/// A word that is not an action.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not an action")]
pub struct UnknownAction(String);

impl fmt::Display for AuditAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for AuditAction {
    type Err = UnknownAction;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let named = AuditAction::ALL.iter().copied().find(|action| action.name() == text);
        named.ok_or_else(|| UnknownAction(text.chars().take(64).collect()))
    }
}

/// One entry: who did what, when, and from where. Entries never change.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AuditEntry {
    /// Its place in the order of all entries.
    pub id: i64,
    /// When.
    pub at: Timestamp,
    /// Who: the name of the token, or `this machine` for what was done beside the service.
    pub actor: String,
    /// The role of the token.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// The token, also of a session that began with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token_id: Option<TokenId>,
    /// Address of the connection's other end. Behind a proxy, that of the proxy.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
    /// What was done.
    pub action: AuditAction,
    /// With what: an id, or the name of a project.
    pub target: String,
    /// The project that it concerns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub project: Option<String>,
    /// What was asked for, without secrets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Object>)]
    pub detail: Option<serde_json::Value>,
}

/// One page of entries, newest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AuditPage {
    /// The entries.
    pub items: Vec<AuditEntry>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_action_has_one_name_everywhere() {
        for action in AuditAction::ALL {
            assert_eq!(serde_json::to_value(action).unwrap(), action.name());
            assert_eq!(action.name().parse(), Ok(*action));
        }
        assert!("job_painted".parse::<AuditAction>().is_err());
    }
}
