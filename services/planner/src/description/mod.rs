//! Farm descriptions: names instead of numbers, hours instead of work, weekly windows instead of instants.
//! The crate's README documents the fields, and `farm.example.json` shows most of them.

mod demands;
mod entries;
mod error;
mod values;

use std::collections::BTreeMap;
use std::sync::Arc;

use jiff::Timestamp;
use jiff::tz::TimeZoneDatabase;

use self::demands::{Demands, WORK_PER_SECOND};
pub use self::entries::Description;
use self::entries::{Frames, JobEntry, NodeEntry, ProjectEntry, RangeEntry, WindowEntry};
pub use self::error::DescriptionError;
use self::values::{duration, known, money, names, scaled};
use crate::civil::{Weekly, expand};
use crate::model::{
    Confidence, Division, FixedBooking, Frame, Input, Interval, Job, Node, Power, Project, SharedCache,
    Usage, WorkTotal,
};

/// Per job.
const MOST_FRAMES: u32 = 1_000_000;

/// Calendars are expanded this far beyond the last deadline and release, microseconds.
const BEYOND: i64 = 28 * 86_400_000_000;

impl Description {
    /// Converts the description to the planner's input. Ids are positions in the lists. `zones` resolves time
    /// zones; [`jiff::tz::db`] is the usual one.
    ///
    /// # Errors
    /// The first error in the description.
    pub fn input(&self, zones: &TimeZoneDatabase) -> Result<Input, DescriptionError> {
        let now = self.now.as_microsecond();
        let instants = self.jobs.iter().flat_map(|job| [job.release, job.deadline]).flatten();
        let horizon = instants.map(Timestamp::as_microsecond).fold(now, i64::max).saturating_add(BEYOND);
        let projects = names("project", self.projects.iter().map(|project| &project.name))?;
        names("job", self.jobs.iter().map(|job| &job.name))?;
        let demands = Demands::new(&self.nodes, &self.jobs)?;
        let mut nodes: Vec<Node> = Vec::new();
        for entry in &self.nodes {
            let model = self.node(entry, &demands, zones, now, horizon)?;
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
            })
        });
        let jobs = self.jobs.iter().zip(0..).map(|(entry, id)| job(entry, id, now, &demands, &projects));
        let half_life = self.half_life.as_ref().map_or(Ok(0), |text| duration(text, "half_life"))?;
        Ok(Input {
            now,
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

    fn node(
        &self,
        entry: &NodeEntry,
        demands: &Demands,
        zones: &TimeZoneDatabase,
        now: i64,
        horizon: i64,
    ) -> Result<Node, DescriptionError> {
        let at = format!("node {:?}", entry.name);
        let time = |text: &Option<String>, field: &str| {
            text.as_ref().map_or(Ok(0), |text| duration(text, &format!("{at}, {field}")))
        };
        let available_from = entry.available_from.map_or(now, Timestamp::as_microsecond);
        let calendar = match &entry.calendar {
            None => vec![Interval { start: now, end: None }],
            Some(windows) => {
                let weekly: Result<Vec<Weekly>, _> =
                    windows.iter().map(|window| self.weekly(window, zones, &at)).collect();
                expand(&weekly?, now, horizon)
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
            speed: scaled(entry.speed, WORK_PER_SECOND, &at, "speed")?,
            speeds: Arc::new(demands.speeds(entry)?),
            serial: Arc::default(),
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

    fn weekly(
        &self,
        window: &WindowEntry,
        zones: &TimeZoneDatabase,
        at: &str,
    ) -> Result<Weekly, DescriptionError> {
        let name = window.zone.as_ref().unwrap_or(&self.zone);
        let unknown =
            |_| DescriptionError::Unknown { at: at.to_owned(), what: "time zone", name: name.clone() };
        Ok(Weekly {
            zone: zones.get(name).map_err(unknown)?,
            days: window.days.clone(),
            from: window.from,
            until: window.until,
        })
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
    demands: &Demands,
    projects: &BTreeMap<String, u64>,
) -> Result<Job, DescriptionError> {
    let at = format!("job {:?}", entry.name);
    let wrong = |reason: &str| DescriptionError::Value { at: at.clone(), reason: reason.to_owned() };
    let work = |hours: f64, field: &str| scaled(hours, 3600.0 * WORK_PER_SECOND, &at, field);
    if entry.spread < 1.0 || entry.frame_spread < 1.0 {
        return Err(wrong("a spread is P80 over P50 and must be at least 1"));
    }
    let listed: Vec<(i64, f64)> = match (&entry.frames, entry.hours) {
        (Frames::Count(count), _) if *count > MOST_FRAMES => {
            return Err(wrong(&format!("{count} frames are too many: a job has at most {MOST_FRAMES}")));
        }
        (Frames::Count(count), Some(hours)) => (0..i64::from(*count)).map(|number| (number, hours)).collect(),
        (Frames::Count(_), None) => {
            return Err(wrong("frames is a count, so set hours, the median of one frame"));
        }
        (Frames::List(_), Some(_)) => {
            return Err(wrong("each frame lists its hours, so remove hours from the job"));
        }
        (Frames::List(frames), None) => frames.iter().map(|frame| (frame.number, frame.hours)).collect(),
    };
    let division = match (entry.parts, entry.exact_parts) {
        (Some(_), Some(_)) => {
            return Err(wrong("parts is a limit and exact_parts a number: set one of them"));
        }
        (None, Some(parts)) => Division::Into(parts),
        (Some(parts), None) => Division::UpTo(parts),
        (None, None) => Division::Whole,
    };
    let mut frames = Vec::with_capacity(listed.len());
    for (number, hours) in listed {
        let p80 = work(hours * entry.frame_spread * entry.spread, "hours")?;
        frames.push(Frame {
            number,
            work: work(hours, "hours")?,
            work_p80: p80,
            division,
            ..Frame::default()
        });
    }
    let p50 = frames.iter().fold(0u64, |sum, frame| sum.saturating_add(frame.work));
    // For a lognormal factor: z of 95 % over z of 80 %.
    let quantile = |z: f64| (p50 as f64 * libm::pow(entry.spread, z)).round() as u64;
    let p80 = quantile(1.0).max(p50);
    Ok(Job {
        id,
        name: entry.name.clone(),
        project: entry.project.as_ref().map(|name| known(projects, "project", name, &at)).transpose()?,
        class: demands.class(&entry.class, entry)?,
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
        shared_cache: match entry.shared_cache_hours {
            None => None,
            Some(hours) => Some(SharedCache {
                class: demands.class(&entry.shared_cache_class, entry)?,
                work: work(hours, "shared_cache_hours")?,
                parts: entry.shared_cache_parts,
            }),
        },
        frames,
        done: Vec::new(),
        part_overhead: work(entry.part_overhead_hours, "part_overhead_hours")?,
        budget: entry.budget.map(|budget| money(budget, &at, "budget")).transpose()?,
    })
}
