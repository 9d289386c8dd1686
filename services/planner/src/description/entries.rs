//! The fields of a description, and their defaults.

use std::collections::BTreeMap;

use jiff::Timestamp;
use jiff::civil::{Time, Weekday};
use jiff::fmt::strtime;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

/// A farm description.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    pub(super) now: Timestamp,
    /// Default time zone of windows.
    #[serde(default = "utc")]
    pub(super) zone: String,
    pub(super) half_life: Option<String>,
    #[serde(default)]
    pub(super) projects: Vec<ProjectEntry>,
    pub(super) nodes: Vec<NodeEntry>,
    #[serde(default)]
    pub(super) jobs: Vec<JobEntry>,
    #[serde(default)]
    pub(super) fixed: Vec<FixedEntry>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ProjectEntry {
    pub(super) name: String,
    #[serde(default = "one")]
    pub(super) share: u32,
    #[serde(default)]
    pub(super) used: Vec<UsedEntry>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct UsedEntry {
    pub(super) at: Timestamp,
    pub(super) hours: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NodeEntry {
    pub(super) name: String,
    #[serde(default = "one")]
    pub(super) count: u32,
    #[serde(default = "unit")]
    pub(super) speed: f64,
    #[serde(default)]
    pub(super) speeds: BTreeMap<String, f64>,
    #[serde(default)]
    pub(super) cores: u32,
    #[serde(default)]
    pub(super) memory_gib: f64,
    #[serde(default)]
    pub(super) gpu_memory_gib: f64,
    #[serde(default)]
    pub(super) price_per_hour: f64,
    pub(super) billing_step: Option<String>,
    pub(super) minimum_booking: Option<String>,
    pub(super) setup: Option<String>,
    #[serde(default)]
    pub(super) setup_cost: f64,
    #[serde(default)]
    pub(super) on: bool,
    pub(super) available_from: Option<Timestamp>,
    pub(super) calendar: Option<Vec<WindowEntry>>,
    #[serde(default)]
    pub(super) maintenance: Vec<RangeEntry>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WindowEntry {
    #[serde(default, deserialize_with = "days")]
    pub(super) days: Vec<Weekday>,
    pub(super) from: Time,
    pub(super) until: Time,
    pub(super) zone: Option<String>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RangeEntry {
    pub(super) start: Timestamp,
    pub(super) end: Option<Timestamp>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FixedEntry {
    pub(super) node: String,
    pub(super) start: Timestamp,
    pub(super) end: Timestamp,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JobEntry {
    pub(super) name: String,
    pub(super) project: Option<String>,
    pub(super) class: Option<String>,
    pub(super) release: Option<Timestamp>,
    pub(super) deadline: Option<Timestamp>,
    #[serde(default)]
    pub(super) priority: i32,
    #[serde(default = "one")]
    pub(super) weight: u32,
    #[serde(default = "eighty")]
    pub(super) confidence: u8,
    pub(super) frames: Frames,
    /// Median hours of a frame at speed one, if `frames` is a count.
    pub(super) hours: Option<f64>,
    /// P80 over P50 of one frame's work.
    #[serde(default = "unit")]
    pub(super) frame_spread: f64,
    /// P80 over P50 of the whole job's work.
    #[serde(default = "unit")]
    pub(super) spread: f64,
    #[serde(alias = "seed_hours")]
    pub(super) shared_cache_hours: Option<f64>,
    #[serde(alias = "seed_class")]
    pub(super) shared_cache_class: Option<String>,
    /// The number of equal parts of the shared cache.
    #[serde(default = "one", alias = "seed_parts")]
    pub(super) shared_cache_parts: u32,
    #[serde(default)]
    pub(super) memory_gib: f64,
    #[serde(default)]
    pub(super) gpu_memory_gib: f64,
    #[serde(default)]
    pub(super) cores: u32,
    /// The most parts of a frame, where parts help.
    pub(super) parts: Option<u32>,
    /// The number of parts of every frame.
    pub(super) exact_parts: Option<u32>,
    #[serde(default)]
    pub(super) part_overhead_hours: f64,
    pub(super) budget: Option<f64>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "frames: write how many there are, or a list of {\"number\": 1, \"hours\": 0.5}"
)]
pub(super) enum Frames {
    Count(u32),
    List(Vec<FrameEntry>),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameEntry {
    pub(super) number: i64,
    pub(super) hours: f64,
}

fn days<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Weekday>, D::Error> {
    let day = |name: &String| {
        let parsed = strtime::parse("%a", name).ok().and_then(|time| time.weekday());
        parsed.ok_or_else(|| D::Error::custom(format!("{name:?} is not a day of the week: write mon to sun")))
    };
    Vec::<String>::deserialize(deserializer)?.iter().map(day).collect()
}

fn utc() -> String {
    "UTC".to_owned()
}

fn one() -> u32 {
    1
}

fn unit() -> f64 {
    1.0
}

fn eighty() -> u8 {
    80
}
