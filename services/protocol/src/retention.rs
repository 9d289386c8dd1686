//! How long the farm keeps what it has made.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::Timestamp;

/// What is deleted with time.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RetentionKind {
    /// Images, previews and cost maps of a job, counted from its end.
    Images,
    /// Profiles and irradiance caches of a job, counted from its end.
    Profiles,
    /// Uploaded scenes, counted from the end of the last job that used them, or else from their upload.
    Scenes,
    /// Lines of logs, counted from when they were written.
    Logs,
    /// Events, counted from when they happened.
    Events,
    /// Plans, counted from when they were made. The newest plan, and plans of kept jobs, stay.
    Plans,
    /// All that is left of a job, counted from its end. What it cost stays in the books of its project.
    Jobs,
    /// Entries of the audit, counted from when they were made.
    Audit,
}

impl RetentionKind {
    /// All kinds, in the order in which they are deleted.
    pub const ALL: [RetentionKind; 8] = [
        RetentionKind::Logs,
        RetentionKind::Events,
        RetentionKind::Images,
        RetentionKind::Profiles,
        RetentionKind::Jobs,
        RetentionKind::Plans,
        RetentionKind::Scenes,
        RetentionKind::Audit,
    ];

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            RetentionKind::Images => "images",
            RetentionKind::Profiles => "profiles",
            RetentionKind::Scenes => "scenes",
            RetentionKind::Logs => "logs",
            RetentionKind::Events => "events",
            RetentionKind::Plans => "plans",
            RetentionKind::Jobs => "jobs",
            RetentionKind::Audit => "audit",
        }
    }

    /// Whether each project may have a rule of its own. The others are one for the whole farm.
    pub const fn is_by_project(self) -> bool {
        matches!(self, RetentionKind::Images | RetentionKind::Profiles | RetentionKind::Jobs)
    }

    /// Days that things are kept where nobody has set a rule.
    pub const fn default_days(self) -> u32 {
        match self {
            RetentionKind::Profiles => 7,
            RetentionKind::Plans => 14,
            RetentionKind::Logs => 30,
            RetentionKind::Images | RetentionKind::Scenes | RetentionKind::Events => 90,
            RetentionKind::Jobs => 365,
            RetentionKind::Audit => 1095,
        }
    }
}

/// Sets how long something is kept.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RetentionRule {
    /// The project; absent for the whole farm. Projects can have rules for images, profiles and jobs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub project: Option<String>,
    /// What the rule is about.
    pub kind: RetentionKind,
    /// Days, 0 to 36,500. Absent: it is kept for ever.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 36500)]
    pub days: Option<u32>,
}

/// How long things are kept.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Retention {
    /// The rules of the farm, one for each kind, then those of projects.
    pub items: Vec<RetentionRule>,
    /// The last time that something was deleted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last: Option<Pruned>,
}

/// Asks for things that are past their time to be deleted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PruneRequest {
    /// Only says what would be deleted.
    #[serde(default)]
    pub dry_run: bool,
}

/// What was deleted of one kind.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PrunedKind {
    /// The kind.
    pub kind: RetentionKind,
    /// How much: jobs for images, profiles and jobs; scenes, lines, events, plans.
    pub number: u64,
    /// Size of the files that nothing may refer to now. They are deleted after a day of that.
    pub bytes: u64,
}

/// Numbers of files, and their size.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Files {
    /// Number of files.
    pub number: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// What was deleted, or would be.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Pruned {
    /// When.
    pub at: Timestamp,
    /// Whether nothing was deleted.
    pub dry_run: bool,
    /// By kind.
    pub items: Vec<PrunedKind>,
    /// Files of artefacts that nothing had referred to for a day.
    pub deleted: Files,
    /// Files of artefacts that nothing refers to, and that wait for this day to pass.
    pub waiting: Files,
}
