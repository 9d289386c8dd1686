//! Worlds to simulate.

use forelight_planner::chance::{between, bits, normal};
use forelight_planner::{
    Confidence, Division, Frame, Input, InputError, Interval, Job, Project, SharedCache, WorkTotal,
};
use serde::{Deserialize, Serialize};

use crate::reference::{self, Size};
use crate::world::{Chances, World};

const MINUTE: i64 = 60_000_000;
const HOUR: i64 = 60 * MINUTE;
const DAY: i64 = 24 * HOUR;
/// Projects. Their shares equal their numbers.
const PROJECTS: u64 = 3;

/// Size of a studio, and the time simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Scenario {
    /// Nodes, from 10 to 10,000 in 5 to 20 classes.
    pub nodes: u64,
    /// Jobs that come in.
    pub jobs: u64,
    /// Frames of all jobs together.
    pub frames: u64,
    /// Days over which they come in.
    pub days: u64,
    /// Typical minutes of a frame at speed 1. Nodes have speeds from 0.6 to 3.
    pub frame_minutes: u64,
    /// Confidence of every job. `None`: a third each of P50, P80 and P95.
    pub confidence: Option<Confidence>,
    /// Number of parts of a shared cache. 1: in one piece.
    pub parts: u32,
}

impl Scenario {
    /// A month of a large studio: 1,000 nodes, 300 jobs, 45,000 frames.
    pub const MONTH: Scenario = Scenario {
        nodes: 1000,
        jobs: 300,
        frames: 45_000,
        days: 30,
        frame_minutes: 180,
        confidence: Some(Confidence::P95),
        parts: 1,
    };
    /// Three weeks of a small studio with frames of fifteen hours, longer than a night on most nodes.
    pub const SHOTS: Scenario = Scenario {
        nodes: 60,
        jobs: 150,
        frames: 1000,
        days: 21,
        frame_minutes: 900,
        confidence: Some(Confidence::P80),
        parts: 8,
    };
    /// A small studio with slightly over a thousand jobs at this confidence.
    pub const fn promises(confidence: Confidence) -> Scenario {
        Scenario {
            nodes: 60,
            jobs: 1150,
            frames: 23_000,
            days: 60,
            frame_minutes: 120,
            confidence: Some(confidence),
            parts: 1,
        }
    }

    /// The world with these chances.
    ///
    /// # Errors
    /// None are known. The planner checks its input.
    pub fn world(&self, chances: Chances) -> Result<World, InputError> {
        World::new(studio(*self, chances.seed), chances)
    }
}

/// A studio as [`reference::studio`] draws it. Jobs come in at any time, with deadlines 16 to 72 hours later.
pub fn studio(scenario: Scenario, seed: u64) -> Input {
    let size = Size {
        jobs: scenario.jobs,
        frames: scenario.frames.max(scenario.jobs),
        nodes: scenario.nodes,
        classes: (scenario.nodes / 2).clamp(5, 20),
        days: scenario.days,
    };
    let mut input = reference::studio(size, seed);
    input.projects = (1..=PROJECTS)
        .map(|id| Project { id, name: format!("project-{id}"), share: id as u32, usage: Vec::new() })
        .collect();
    // The reference farm's frames typically take two hours.
    let scaled = |work: u64| {
        u64::try_from(u128::from(work) * u128::from(scenario.frame_minutes) / 120).unwrap_or(u64::MAX).max(1)
    };
    let end = scenario.days as i64 * DAY;
    for job in &mut input.jobs {
        let release = between(seed, &[101, job.id], 0, end) / MINUTE * MINUTE;
        job.release = release;
        job.deadline = Some(release + between(seed, &[102, job.id], 16 * HOUR, 72 * HOUR) / MINUTE * MINUTE);
        for frame in &mut job.frames {
            (frame.work, frame.work_p80) = (scaled(frame.work), scaled(frame.work_p80));
        }
        let total = &mut job.total;
        (total.p50, total.p80, total.p95) = (scaled(total.p50), scaled(total.p80), scaled(total.p95));
        job.shared_cache = job.shared_cache.map(|cache| SharedCache {
            work: scaled(cache.work),
            parts: scenario.parts.max(1),
            ..cache
        });
        job.project = Some(1 + bits(seed, &[103, job.id]) % PROJECTS);
        job.priority = (bits(seed, &[104, job.id]) % 3) as i32;
        if let Some(confidence) = scenario.confidence {
            job.confidence = confidence;
        }
    }
    // Nights go on until the last job is done.
    for node in input.nodes.iter_mut().filter(|node| node.calendar.len() > 1) {
        let days = scenario.days as i64;
        let more = (days + 1..=days + 30)
            .map(|day| Interval { start: day * DAY - 4 * HOUR, end: Some(day * DAY + 8 * HOUR) });
        node.calendar.extend(more);
    }
    input
}

/// Stills that come in each day, and the days. A still typically takes eight hours at speed 1.
const STILLS_A_DAY: u64 = 100;
const DAYS_OF_STILLS: u64 = 10;
const STILL: f64 = 8.0 * 3.6e12;
/// Work of half a minute at speed 1.
const OVERHEAD_OF_A_PART: u64 = 30_000_000_000;

/// Artists' stills on 100 nodes of a studio: jobs of one frame, at any time, without deadlines. A frame may
/// have at most `parts` parts.
pub fn stills(parts: u32, seed: u64) -> Input {
    let count = STILLS_A_DAY * DAYS_OF_STILLS;
    let size = Size { jobs: 0, frames: 0, nodes: 100, classes: 20, days: DAYS_OF_STILLS + 30 };
    let mut input = reference::studio(size, seed);
    let end = DAYS_OF_STILLS as i64 * DAY;
    let mut releases: Vec<i64> = (0..count).map(|id| between(seed, &[111, id], 0, end)).collect();
    releases.sort_unstable();
    let still = |(id, release): (u64, i64)| {
        let work = (STILL * libm::exp(0.5 * normal(seed, &[112, id]))).round() as u64;
        Job {
            id,
            name: format!("still-{id}"),
            release,
            total: WorkTotal { p50: work, p80: work + work / 5, p95: work + work / 2 },
            frames: vec![Frame {
                number: 0,
                work,
                work_p80: work + work / 5,
                division: Division::UpTo(parts),
                ..Frame::default()
            }],
            part_overhead: OVERHEAD_OF_A_PART,
            ..Job::default()
        }
    };
    input.jobs = (0..).zip(releases).map(still).collect();
    input
}
