//! Jobs, their forecast work, and the projects that they belong to.

use serde::{Deserialize, Serialize};

use super::plan::Task;

/// Standard normal quantiles at 80 % and 95 %.
const Z80: f64 = 0.841_621_233_572_914_2;
const Z95: f64 = 1.644_853_626_951_472_6;

/// Frames that are rendered together.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Job {
    /// Identity, opaque to the planner. Ties go to the lower one.
    pub id: u64,
    /// Name for people.
    pub name: String,
    /// The project that it belongs to.
    pub project: Option<u64>,
    /// Class of its frames' work, which decides the nodes that can do it, and their speed. See
    /// [`super::Node::speeds`].
    pub class: u32,
    /// Nothing may start before this instant.
    pub release: i64,
    /// The last frame should end by this instant.
    pub deadline: Option<i64>,
    /// If not all deadlines can be met, those of higher priorities are met first. Jobs without a deadline
    /// start in this order.
    pub priority: i32,
    /// Weight among jobs of equal priority: weight two counts as much as two jobs of weight one. Zero counts
    /// as one.
    pub weight: u32,
    /// The quantile of the job's work for which capacity is booked.
    pub confidence: Confidence,
    /// Forecast work of all frames together.
    pub total: WorkTotal,
    /// Work that must be done before any frame starts: a shared cache, for instance.
    pub shared_cache: Option<SharedCache>,
    /// Its frames.
    pub frames: Vec<Frame>,
    /// Numbers of the frames that need no booking: they are done, or run as fixed bookings.
    pub done: Vec<i64>,
    /// Work that each part of a divided frame costs on top of its share of the frame: loading, building the
    /// tree, uploading, and its share of dividing and assembling. Zero: nothing is known of dividing.
    pub part_overhead: u64,
    /// The most that the job may cost, in micro-units.
    pub budget: Option<i64>,
}

/// A frame's forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Frame {
    /// Unique in its job.
    pub number: i64,
    /// Median of its work.
    pub work: u64,
    /// P80 of its work. Zero: only the median is known.
    pub work_p80: u64,
    /// Whether it may be divided.
    pub division: Division,
    /// The frame that it is a part of, if it is one that was divided before. Parts of one frame take longer
    /// or shorter than forecast together.
    pub part_of: Option<i64>,
}

/// How a frame may be divided into parts that different nodes render at the same time. All parts of a frame
/// have the same forecast work; see [`Job::part_work`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Division {
    /// One node renders all of it.
    #[default]
    Whole,
    /// Whole, or in at most so many parts where that helps. 0 or 1: whole.
    UpTo(u32),
    /// In exactly so many parts. 0 or 1: whole.
    Into(u32),
}

impl Division {
    /// The fewest parts that it allows. One stands for the whole frame.
    pub fn fewest(self) -> u32 {
        match self {
            Division::Whole | Division::UpTo(_) => 1,
            Division::Into(parts) => parts.max(1),
        }
    }

    /// The most parts that it allows. One stands for the whole frame.
    pub fn most(self) -> u32 {
        match self {
            Division::Whole => 1,
            Division::UpTo(parts) | Division::Into(parts) => parts.max(1),
        }
    }

    /// Whether a frame may be done in so many parts. One stands for the whole frame.
    pub fn allows(self, parts: u32) -> bool {
        (self.fewest()..=self.most()).contains(&parts)
    }
}

/// Work that comes before all frames of a job, such as a shared irradiance cache or a simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SharedCache {
    /// Class of its work.
    pub class: u32,
    /// Median of its work.
    pub work: u64,
    /// The number of equal parts that can run at the same time. 0 or 1: it is not split.
    pub parts: u32,
}

impl SharedCache {
    /// Its tasks: one for each part.
    pub fn tasks(self) -> impl Iterator<Item = Task> {
        let parts = self.parts.max(1);
        let task =
            move |part| if parts == 1 { Task::SharedCache } else { Task::SharedCachePart { part, parts } };
        (0..parts).map(task)
    }
}

/// Quantiles of the work of all frames of a job. They include the error that the frames share, so they are
/// not sums of the frames' quantiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkTotal {
    /// Median.
    pub p50: u64,
    /// 80 % quantile.
    pub p80: u64,
    /// 95 % quantile.
    pub p95: u64,
}

/// The probability with which the booked capacity should be enough.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Confidence {
    /// 50 %.
    P50,
    /// 80 %.
    #[default]
    P80,
    /// 95 %.
    P95,
}

/// A user or group with a share of the farm.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Project {
    /// Identity.
    pub id: u64,
    /// Name for people.
    pub name: String,
    /// Its share, relative to the others. Zero counts as one.
    pub share: u32,
    /// Node time that it used.
    pub usage: Vec<Usage>,
}

/// Node time that a project used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Usage {
    /// When the use ended.
    pub at: i64,
    /// Microseconds of a node.
    pub time: i64,
}

impl Confidence {
    /// The quantile of the standard normal distribution at this probability.
    pub fn z(self) -> f64 {
        match self {
            Confidence::P50 => 0.0,
            Confidence::P80 => Z80,
            Confidence::P95 => Z95,
        }
    }

    /// As a number from 0 to 1.
    pub fn probability(self) -> f64 {
        match self {
            Confidence::P50 => 0.5,
            Confidence::P80 => 0.8,
            Confidence::P95 => 0.95,
        }
    }
}

/// Standard deviation of the logarithm, from median and P80. Zero if they are unknown.
fn log_spread(p50: u64, p80: u64) -> f64 {
    if p50 == 0 || p80 <= p50 { 0.0 } else { libm::log(p80 as f64 / p50 as f64) / Z80 }
}

impl WorkTotal {
    /// The quantile at this confidence.
    pub fn at(&self, confidence: Confidence) -> u64 {
        match confidence {
            Confidence::P50 => self.p50,
            Confidence::P80 => self.p80,
            Confidence::P95 => self.p95,
        }
    }
}

impl Job {
    /// Work to book for each frame: its median, scaled so that all frames together reach the job's total at
    /// its confidence, rounded up.
    ///
    /// The error that all frames share does not average out, so one factor scales the whole job. The sum of
    /// the frames' quantiles would book too much. The sum of their medians would be too little half of the
    /// time.
    pub fn bought_work(&self) -> Vec<u64> {
        let medians = self.medians();
        self.frames
            .iter()
            .map(|frame| match medians {
                // Without medians, all frames get the same part.
                0 => self.share(1, self.frames.len() as u128),
                _ => self.share(frame.work, medians),
            })
            .collect()
    }

    /// The factor that all frames share at the normal quantile z, relative to the median. Interpolates
    /// linearly between the logarithms of the total's P50, P80 and P95, and extrapolates at both ends.
    pub fn common_factor(&self, z: f64) -> f64 {
        let first = log_spread(self.total.p50, self.total.p80);
        let log = if z <= Z80 {
            first * z
        } else if self.total.p80 == 0 {
            0.0
        } else {
            let second = libm::log(self.total.p95 as f64 / self.total.p80 as f64) / (Z95 - Z80);
            first * Z80 + second * (z - Z80)
        };
        libm::exp(log)
    }

    /// Standard deviation of the logarithm of a frame's own factor, without the shared one.
    pub fn own_spread(&self, frame: &Frame) -> f64 {
        let common = log_spread(self.total.p50, self.total.p80);
        libm::sqrt(f64::max(0.0, libm::pow(log_spread(frame.work, frame.work_p80), 2.0) - common * common))
    }

    /// Number and booked work of the frames that still need a booking.
    pub fn open_work(&self) -> impl Iterator<Item = (i64, u64)> {
        self.open_frames().map(|(frame, work)| (frame.number, work))
    }

    /// The frames that still need a booking, and the work to book for each as a whole.
    pub fn open_frames(&self) -> impl Iterator<Item = (&Frame, u64)> {
        let done: std::collections::BTreeSet<i64> = self.done.iter().copied().collect();
        self.frames.iter().zip(self.bought_work()).filter(move |(frame, _)| !done.contains(&frame.number))
    }

    /// Work to book for each part of a frame that is divided into so many: its share of the frame's booked
    /// work, rounded up, and [`Job::part_overhead`]. A whole frame has no overhead.
    pub fn part_work(&self, frame_work: u64, parts: u32) -> u64 {
        frame_work.div_ceil(u64::from(parts.max(1))).saturating_add(self.part_overhead)
    }

    /// The least work that a plan can book for a frame with this booked work: that of its fewest parts.
    pub fn least_work(&self, frame_work: u64, division: Division) -> u128 {
        match division.fewest() {
            1 => u128::from(frame_work),
            parts => u128::from(self.part_work(frame_work, parts)) * u128::from(parts),
        }
    }

    /// Work of the longest task of a frame with this booked work, if it has as many parts as help.
    pub fn longest_part(&self, frame_work: u64, division: Division) -> u64 {
        let divided = match division.most() {
            1 => frame_work,
            parts => self.part_work(frame_work, parts),
        };
        if division.allows(1) { divided.min(frame_work) } else { divided }
    }

    /// Work to book for the whole shared cache: its median, scaled as the frames are.
    pub fn bought_shared_cache(&self) -> Option<u64> {
        let cache = self.shared_cache?;
        Some(match self.medians() {
            0 => cache.work,
            medians => self.share(cache.work, medians),
        })
    }

    /// Work to book for one of the shared cache's tasks. `None` for other tasks.
    pub fn shared_cache_work(&self, task: Task) -> Option<u64> {
        let cache = self.shared_cache?;
        let work = self.bought_shared_cache()?;
        cache.tasks().any(|own| own == task).then(|| work.div_ceil(u64::from(cache.parts.max(1))))
    }

    fn medians(&self) -> u128 {
        self.frames.iter().map(|frame| u128::from(frame.work)).sum()
    }

    /// `work / whole` of the total at the job's confidence, rounded up.
    fn share(&self, work: u64, whole: u128) -> u64 {
        let total = u128::from(self.total.at(self.confidence));
        let product = u128::from(work) * total;
        u64::try_from(product.div_ceil(whole.max(1))).unwrap_or(u64::MAX)
    }

    /// The job's weight, at least one.
    pub(crate) fn worth(&self) -> u32 {
        self.weight.max(1)
    }
}
