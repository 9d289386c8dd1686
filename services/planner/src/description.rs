//! A farm and its jobs as people write them: names instead of numbers, hours instead of work, weekly windows instead of instants. The
//! crate's README documents the fields, and `farm.example.json` shows most of them.

use std::collections::BTreeMap;

use jiff::civil::{Time, Weekday};
use jiff::{SignedDuration, Span, SpanRelativeTo, Timestamp};
use serde::Deserialize;

use crate::civil::{CalendarError, Weekly, expand};
use crate::model::{
    Confidence, FixedBooking, Frame, Input, Interval, Job, Limit, LimitUse, Node, Power, Project, Seed,
    Usage, WorkTotal,
};

/// Work of a second at speed one.
const WORK_PER_SECOND: f64 = 1e9;
const MICRO: f64 = 1e6;
const GIB: f64 = (1u64 << 30) as f64;
/// Calendars are expanded this far beyond the last deadline and release.
const BEYOND: i64 = 28 * 86_400_000_000;

/// A farm description.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    now: Timestamp,
    /// Time zone of windows that name none.
    #[serde(default = "utc")]
    zone: String,
    half_life: Option<String>,
    #[serde(default)]
    limits: Vec<LimitEntry>,
    #[serde(default)]
    projects: Vec<ProjectEntry>,
    nodes: Vec<NodeEntry>,
    #[serde(default)]
    jobs: Vec<JobEntry>,
    #[serde(default)]
    fixed: Vec<FixedEntry>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitEntry {
    name: String,
    count: u64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProjectEntry {
    name: String,
    #[serde(default = "one")]
    share: u32,
    #[serde(default)]
    used: Vec<UsedEntry>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct UsedEntry {
    at: Timestamp,
    hours: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NodeEntry {
    name: String,
    #[serde(default = "one")]
    count: u32,
    #[serde(default = "unit")]
    speed: f64,
    #[serde(default)]
    speeds: BTreeMap<String, f64>,
    #[serde(default)]
    cores: u32,
    #[serde(default)]
    memory_gib: f64,
    #[serde(default)]
    gpu_memory_gib: f64,
    #[serde(default)]
    price_per_hour: f64,
    billing_step: Option<String>,
    minimum_booking: Option<String>,
    setup: Option<String>,
    #[serde(default)]
    setup_cost: f64,
    #[serde(default)]
    on: bool,
    available_from: Option<Timestamp>,
    calendar: Option<Vec<WindowEntry>>,
    #[serde(default)]
    maintenance: Vec<RangeEntry>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WindowEntry {
    #[serde(default)]
    days: Vec<Day>,
    from: Time,
    until: Time,
    zone: Option<String>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Day {
    Mon,
    Tue,
    Wed,
    Thu,
    Fri,
    Sat,
    Sun,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RangeEntry {
    start: Timestamp,
    end: Option<Timestamp>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FixedEntry {
    node: String,
    start: Timestamp,
    end: Timestamp,
    #[serde(default)]
    limits: BTreeMap<String, u64>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct JobEntry {
    name: String,
    project: Option<String>,
    class: Option<String>,
    release: Option<Timestamp>,
    deadline: Option<Timestamp>,
    #[serde(default)]
    priority: i32,
    #[serde(default = "one")]
    weight: u32,
    #[serde(default = "eighty")]
    confidence: u8,
    frames: Frames,
    /// Median hours of a frame at speed one, where `frames` is a count.
    hours: Option<f64>,
    /// P80 over P50 of one frame's work.
    #[serde(default = "unit")]
    frame_spread: f64,
    /// P80 over P50 of the whole job's work.
    #[serde(default = "unit")]
    spread: f64,
    seed_hours: Option<f64>,
    seed_class: Option<String>,
    /// Into how many equal parts the seed is split.
    #[serde(default = "one")]
    seed_parts: u32,
    #[serde(default)]
    memory_gib: f64,
    #[serde(default)]
    gpu_memory_gib: f64,
    #[serde(default)]
    cores: u32,
    #[serde(default)]
    limits: BTreeMap<String, u64>,
    #[serde(default = "one")]
    tiles: u32,
    #[serde(default)]
    tile_overhead_hours: f64,
    budget: Option<f64>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
enum Frames {
    Count(u32),
    List(Vec<FrameEntry>),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameEntry {
    number: i64,
    hours: f64,
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

/// What is wrong with a description.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// A name that is used is not defined.
    #[error("{at}: there is no {what} named {name:?}")]
    Unknown {
        /// Where it is used.
        at: String,
        /// Node, limit or project.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// Two things have the same name.
    #[error("{what} {name:?} is given twice")]
    Twice {
        /// Node, job, limit or project.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A value that cannot be.
    #[error("{at}: {reason}")]
    Value {
        /// Where it stands.
        at: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A calendar that cannot be expanded.
    #[error("{at}: {error}")]
    Calendar {
        /// Where it stands.
        at: String,
        /// What is wrong with it.
        error: CalendarError,
    },
}

impl Description {
    /// The planner's input. Identities are places in the lists.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn input(&self) -> Result<Input, DescriptionError> {
        let now = self.now.as_microsecond();
        let instants = self.jobs.iter().flat_map(|job| [job.release, job.deadline]).flatten();
        let horizon = instants.map(Timestamp::as_microsecond).fold(now, i64::max).saturating_add(BEYOND);
        let limits = names("limit", self.limits.iter().map(|limit| &limit.name))?;
        let projects = names("project", self.projects.iter().map(|project| &project.name))?;
        names("job", self.jobs.iter().map(|job| &job.name))?;
        let classes = self.classes();
        let mut nodes: Vec<Node> = Vec::new();
        for entry in &self.nodes {
            let model = self.node(entry, &classes, now, horizon)?;
            for copy in 0..entry.count {
                let name = if entry.count == 1 {
                    entry.name.clone()
                } else {
                    format!("{}-{}", entry.name, copy + 1)
                };
                nodes.push(Node { id: nodes.len() as u64, name, ..model.clone() });
            }
        }
        let by_name = names("node", nodes.iter().map(|node| &node.name))?;
        let fixed = self.fixed.iter().enumerate().map(|(index, entry)| {
            let at = format!("fixed[{index}]");
            Ok(FixedBooking {
                node: known(&by_name, "node", &entry.node, &at)?,
                start: entry.start.as_microsecond(),
                end: entry.end.as_microsecond(),
                job: None,
                uses: uses(&entry.limits, &limits, &at)?,
            })
        });
        let jobs =
            self.jobs.iter().zip(0..).map(|(entry, id)| job(entry, id, now, &classes, &limits, &projects));
        let half_life = self.half_life.as_ref().map_or(Ok(0), |text| duration(text, "half_life"))?;
        Ok(Input {
            now,
            limits: self
                .limits
                .iter()
                .zip(0..)
                .map(|(limit, id)| Limit { id, name: limit.name.clone(), count: limit.count })
                .collect(),
            projects: self
                .projects
                .iter()
                .zip(0..)
                .map(|(entry, id)| project(entry, id))
                .collect::<Result<_, _>>()?,
            half_life,
            fixed: fixed.collect::<Result<_, _>>()?,
            jobs: jobs.collect::<Result<_, _>>()?,
            nodes,
            movable: Vec::new(),
        })
    }

    /// Numbers of the classes of work: the unnamed one is zero, the others follow in the order of their names.
    fn classes(&self) -> BTreeMap<String, u32> {
        let of_nodes = self.nodes.iter().flat_map(|node| node.speeds.keys());
        let of_jobs = self.jobs.iter().flat_map(|job| [&job.class, &job.seed_class]).flatten();
        let all: std::collections::BTreeSet<&String> = of_nodes.chain(of_jobs).collect();
        all.into_iter().cloned().zip(1..).collect()
    }

    fn node(
        &self,
        entry: &NodeEntry,
        classes: &BTreeMap<String, u32>,
        now: i64,
        horizon: i64,
    ) -> Result<Node, DescriptionError> {
        let at = format!("node {:?}", entry.name);
        let time = |text: &Option<String>, field: &str| {
            text.as_ref().map_or(Ok(0), |text| duration(text, &format!("{at}, {field}")))
        };
        let speed = |value: f64, field: &str| scaled(value, WORK_PER_SECOND, &at, field);
        let mut speeds = BTreeMap::new();
        for (class, &value) in &entry.speeds {
            speeds.insert(classes.get(class).copied().unwrap_or(0), speed(value, "speeds")?);
        }
        let available_from = entry.available_from.map_or(now, Timestamp::as_microsecond);
        let calendar = match &entry.calendar {
            None => vec![Interval { start: now, end: None }],
            Some(windows) => {
                let weekly: Vec<Weekly> = windows.iter().map(|window| self.weekly(window)).collect();
                expand(&weekly, now, horizon)
                    .map_err(|error| DescriptionError::Calendar { at: at.clone(), error })?
            }
        };
        let range = |range: &RangeEntry| Interval {
            start: range.start.as_microsecond(),
            end: range.end.map(Timestamp::as_microsecond),
        };
        Ok(Node {
            id: 0,
            name: entry.name.clone(),
            speed: speed(entry.speed, "speed")?,
            speeds,
            cores: entry.cores,
            memory: scaled(entry.memory_gib, GIB, &at, "memory_gib")?,
            gpu_memory: scaled(entry.gpu_memory_gib, GIB, &at, "gpu_memory_gib")?,
            price_per_hour: money(entry.price_per_hour, &at, "price_per_hour")?,
            billing_step: time(&entry.billing_step, "billing_step")?,
            minimum_booking: time(&entry.minimum_booking, "minimum_booking")?,
            setup: time(&entry.setup, "setup")?,
            setup_cost: money(entry.setup_cost, &at, "setup_cost")?,
            power: if entry.on { Power::On } else { Power::Standby },
            available_from,
            calendar,
            maintenance: entry.maintenance.iter().map(range).collect(),
        })
    }

    fn weekly(&self, window: &WindowEntry) -> Weekly {
        let day = |day: &Day| match day {
            Day::Mon => Weekday::Monday,
            Day::Tue => Weekday::Tuesday,
            Day::Wed => Weekday::Wednesday,
            Day::Thu => Weekday::Thursday,
            Day::Fri => Weekday::Friday,
            Day::Sat => Weekday::Saturday,
            Day::Sun => Weekday::Sunday,
        };
        let all = [Day::Mon, Day::Tue, Day::Wed, Day::Thu, Day::Fri, Day::Sat, Day::Sun];
        let days = if window.days.is_empty() { &all[..] } else { &window.days[..] };
        Weekly {
            zone: window.zone.clone().unwrap_or_else(|| self.zone.clone()),
            days: days.iter().map(day).collect(),
            from: window.from,
            until: window.until,
        }
    }
}

fn project(entry: &ProjectEntry, id: u64) -> Result<Project, DescriptionError> {
    let at = format!("project {:?}", entry.name);
    let usage = entry.used.iter().map(|used| {
        let time = scaled(used.hours, 3.6e9, &at, "used")?;
        Ok(Usage { at: used.at.as_microsecond(), time: i64::try_from(time).unwrap_or(i64::MAX) })
    });
    Ok(Project { id, name: entry.name.clone(), share: entry.share, usage: usage.collect::<Result<_, _>>()? })
}

fn job(
    entry: &JobEntry,
    id: u64,
    now: i64,
    classes: &BTreeMap<String, u32>,
    limits: &BTreeMap<String, u64>,
    projects: &BTreeMap<String, u64>,
) -> Result<Job, DescriptionError> {
    let at = format!("job {:?}", entry.name);
    let wrong = |reason: &str| DescriptionError::Value { at: at.clone(), reason: reason.to_owned() };
    let work = |hours: f64, field: &str| scaled(hours, 3600.0 * WORK_PER_SECOND, &at, field);
    let class =
        |name: &Option<String>| name.as_ref().and_then(|name| classes.get(name).copied()).unwrap_or(0);
    if entry.spread < 1.0 || entry.frame_spread < 1.0 {
        return Err(wrong("a spread is P80 over P50 and must be at least 1"));
    }
    let listed: Vec<(i64, f64)> = match (&entry.frames, entry.hours) {
        (Frames::Count(count), Some(hours)) => (0..i64::from(*count)).map(|number| (number, hours)).collect(),
        (Frames::Count(_), None) => {
            return Err(wrong("frames is a count, so hours must say what each takes"));
        }
        (Frames::List(_), Some(_)) => {
            return Err(wrong("each frame has its hours, so the job must have none"));
        }
        (Frames::List(frames), None) => frames.iter().map(|frame| (frame.number, frame.hours)).collect(),
    };
    let mut frames = Vec::with_capacity(listed.len());
    for (number, hours) in listed {
        let p80 = work(hours * entry.frame_spread * entry.spread, "hours")?;
        frames.push(Frame { number, work: work(hours, "hours")?, work_p80: p80 });
    }
    let p50 = frames.iter().fold(0u64, |sum, frame| sum.saturating_add(frame.work));
    // Of a lognormal factor: z of 95 % over z of 80 %.
    let quantile = |z: f64| (p50 as f64 * libm::pow(entry.spread, z)).round() as u64;
    let p80 = quantile(1.0).max(p50);
    Ok(Job {
        id,
        name: entry.name.clone(),
        project: entry.project.as_ref().map(|name| known(projects, "project", name, &at)).transpose()?,
        class: class(&entry.class),
        release: entry.release.map_or(now, Timestamp::as_microsecond),
        deadline: entry.deadline.map(Timestamp::as_microsecond),
        priority: entry.priority,
        weight: entry.weight,
        confidence: match entry.confidence {
            50 => Confidence::P50,
            80 => Confidence::P80,
            95 => Confidence::P95,
            _ => return Err(wrong("confidence must be 50, 80 or 95")),
        },
        total: WorkTotal { p50, p80, p95: quantile(1.954_4).max(p80) },
        seed: match entry.seed_hours {
            None => None,
            Some(hours) => Some(Seed {
                class: class(&entry.seed_class),
                work: work(hours, "seed_hours")?,
                parts: entry.seed_parts,
            }),
        },
        frames,
        done: Vec::new(),
        memory: scaled(entry.memory_gib, GIB, &at, "memory_gib")?,
        gpu_memory: scaled(entry.gpu_memory_gib, GIB, &at, "gpu_memory_gib")?,
        cores: entry.cores,
        uses: uses(&entry.limits, limits, &at)?,
        tiles: entry.tiles,
        tile_overhead: work(entry.tile_overhead_hours, "tile_overhead_hours")?,
        budget: entry.budget.map(|budget| money(budget, &at, "budget")).transpose()?,
    })
}

fn uses(
    held: &BTreeMap<String, u64>,
    limits: &BTreeMap<String, u64>,
    at: &str,
) -> Result<Vec<LimitUse>, DescriptionError> {
    held.iter()
        .map(|(name, &count)| Ok(LimitUse { limit: known(limits, "limit", name, at)?, count }))
        .collect()
}

/// Places by name.
fn names<'n>(
    what: &'static str,
    all: impl Iterator<Item = &'n String>,
) -> Result<BTreeMap<String, u64>, DescriptionError> {
    let mut places = BTreeMap::new();
    for (name, place) in all.zip(0..) {
        if places.insert(name.clone(), place).is_some() {
            return Err(DescriptionError::Twice { what, name: name.clone() });
        }
    }
    Ok(places)
}

fn known(
    places: &BTreeMap<String, u64>,
    what: &'static str,
    name: &str,
    at: &str,
) -> Result<u64, DescriptionError> {
    let unknown = || DescriptionError::Unknown { at: at.to_owned(), what, name: name.to_owned() };
    places.get(name).copied().ok_or_else(unknown)
}

/// A length of time such as `90m`, `1h30m` or `7d`; a day is 24 hours.
fn duration(text: &str, at: &str) -> Result<i64, DescriptionError> {
    let wrong = || DescriptionError::Value {
        at: at.to_owned(),
        reason: format!("{text:?} is no length of time such as 90m, 1h30m or 7d"),
    };
    let span: Span = text.parse().map_err(|_| wrong())?;
    let length: SignedDuration =
        span.to_duration(SpanRelativeTo::days_are_24_hours()).map_err(|_| wrong())?;
    let micros = i64::try_from(length.as_micros()).map_err(|_| wrong())?;
    if micros < 0 { Err(wrong()) } else { Ok(micros) }
}

/// A value that is not negative, in smaller units.
fn scaled(value: f64, units: f64, at: &str, field: &str) -> Result<u64, DescriptionError> {
    let product = (value * units).round();
    if product.is_finite() && (0.0..1.8e19).contains(&product) {
        return Ok(product as u64);
    }
    Err(DescriptionError::Value {
        at: format!("{at}, {field}"),
        reason: format!("{value} is negative or too large"),
    })
}

fn money(value: f64, at: &str, field: &str) -> Result<i64, DescriptionError> {
    let amount = scaled(value, MICRO, at, field)?;
    i64::try_from(amount).map_err(|_| DescriptionError::Value {
        at: format!("{at}, {field}"),
        reason: format!("{value} is too large"),
    })
}
