//! Bearer tokens, as operators see them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{NodeId, PageToken, Role, Timestamp, TokenId};

/// Whom a token belongs to.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TokenKind {
    /// A person.
    #[default]
    Person,
    /// A machine or a program.
    Service,
}

impl TokenKind {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            TokenKind::Person => "person",
            TokenKind::Service => "service",
        }
    }
}

/// A bearer token. The token itself is not shown: the farm keeps only its hash.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Token {
    /// Its id.
    pub id: TokenId,
    /// Name of the person or service.
    pub name: String,
    /// Whom it belongs to.
    #[serde(default)]
    pub kind: TokenKind,
    /// What it allows: in all projects, or the most that it allows in one of `projects`.
    pub role: Role,
    /// The projects that it reaches, with a role in each. Absent if it reaches all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projects: Option<BTreeMap<String, Role>>,
    /// The node that it speaks for. Absent if it is not a node's own token.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node_id: Option<NodeId>,
    /// When it was made.
    pub created_at: Timestamp,
    /// When it expires, or has expired. Absent if it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_at: Option<Timestamp>,
    /// When it was last used, to the minute. Absent if it never was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_used_at: Option<Timestamp>,
}

/// A new token. Its secret is shown only once.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NewToken {
    /// What to send: `Authorization: Bearer …`.
    pub secret: String,
    /// The token.
    pub token: Token,
}

/// Makes a token. Exactly one of `role` and `projects` must be given.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TokenRequest {
    /// Name of the person or service, 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub name: String,
    /// Whom it belongs to.
    #[serde(default)]
    pub kind: TokenKind,
    /// What it allows in all projects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// The projects that it reaches, with a role in each: `viewer` or `submitter`. They must exist. `*`
    /// stands for all projects that are not named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projects: Option<BTreeMap<String, Role>>,
    /// When it expires. If absent, never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_at: Option<Timestamp>,
}

/// Changes a token. Absent fields stay as they are.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TokenChange {
    /// Another name, 1 to 200 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub name: Option<String>,
    /// When it expires. `null`: never.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "crate::node::given")]
    #[schema(value_type = Option<Timestamp>)]
    pub expires_at: Option<Option<Timestamp>>,
    /// Other projects, with a role in each. Only for a token that reaches some projects and not all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projects: Option<BTreeMap<String, Role>>,
}

/// Replaces a token by a new one with the same name, role and end.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RotateRequest {
    /// How long the replaced token is still valid, in seconds: 0 to 604800, a week. Its sessions end with it.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 604_800)]
    pub grace_seconds: u32,
}

/// One page of tokens, oldest first.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TokenPage {
    /// The tokens.
    pub items: Vec<Token>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}
