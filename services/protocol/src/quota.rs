//! Quotas: how much a project or a token may take.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Sets how much a project, or a token, may take. Exactly one of `project` and `token` must be given. An absent
/// limit is none; without any, the quota is removed.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct QuotaRequest {
    /// Name of the project.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub project: Option<String>,
    /// Name of the token. Several tokens of one name share the quota.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub token: Option<String>,
    /// Most bytes of files: scenes, images, profiles and caches. At most 2⁶⁰.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 1_152_921_504_606_846_976_u64)]
    pub storage_bytes: Option<u64>,
    /// Most jobs that are not over, 0 to 1,000,000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 1_000_000)]
    pub open_jobs: Option<u32>,
}

/// A quota, and how much of it is used.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Quota {
    /// What is allowed, and to whom.
    pub allowed: QuotaRequest,
    /// Bytes of files that are used: of the project's jobs, or of the token's jobs and uploads.
    pub used_storage_bytes: u64,
    /// Jobs that are not over.
    pub used_open_jobs: u32,
}

/// All quotas: those of projects, then those of tokens.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct QuotaList {
    /// The quotas.
    pub items: Vec<Quota>,
}
