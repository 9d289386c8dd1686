//! Jobs, what is known of their work, and the projects that they belong to.

use serde::{Deserialize, Serialize};

use super::plan::Task;

/// z of 80 % and 95 %, one-sided.
const Z80: f64 = 0.841_621_233_572_914_2;
const Z95: f64 = 1.644_853_626_951_472_6;

/// Frames to be rendered together.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Job {
    /// Identity, opaque to the planner; ties go to the lower one.
    pub id: u64,
    /// Name for people.
    pub name: String,
    /// The project that it belongs to.
    pub project: Option<u64>,
    /// Class of its frames' work: everything that decides which nodes can do it, and how fast. See
    /// [`super::Node::speeds`].
    pub class: u32,
    /// Nothing may start before this instant.
    pub release: i64,
    /// The last frame should end by this instant.
    pub deadline: Option<i64>,
    /// If not all deadlines can be met, jobs of greater priority have theirs met first; and without a deadline
    /// they go first.
    pub priority: i32,
    /// Among equal priorities: a job of weight two is worth two of weight one, and so is a job of weight zero
    /// or one.
    pub weight: u32,
    /// The quantile of the job's work for which capacity is bought.
    pub confidence: Confidence,
    /// Forecast work of all frames together.
    pub total: WorkTotal,
    /// What has to be done before any frame can start.
    pub shared_cache: Option<SharedCache>,
    /// Its frames.
    pub frames: Vec<Frame>,
    /// Numbers of the frames that need no place any more: they are done, or run as fixed bookings.
    pub done: Vec<i64>,
    /// What the job may cost, in micro-units.
    pub budget: Option<i64>,
}

/// A frame's forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Frame {
    /// The frame's number, unique in its job.
    pub number: i64,
    /// Median of its work.
    pub work: u64,
    /// The work that it exceeds in one case of five; zero: no more is known than the median.
    pub work_p80: u64,
}

/// Work that comes before all frames of a job: an irradiance cache, a simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SharedCache {
    /// Class of its work.
    pub class: u32,
    /// Median of its work.
    pub work: u64,
    /// Into how many equal parts it is split, which may be done at the same time; zero and one: it is not.
    pub parts: u32,
}

impl SharedCache {
    /// What there is to do.
    pub fn tasks(self) -> impl Iterator<Item = Task> {
        let parts = self.parts.max(1);
        let task =
            move |part| if parts == 1 { Task::SharedCache } else { Task::SharedCachePart { part, parts } };
        (0..parts).map(task)
    }
}

/// Quantiles of the work of a job's frames. They hold what the frames have in common: not sums of the frames'
/// quantiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkTotal {
    /// As likely to be more as to be less.
    pub p50: u64,
    /// Enough in four cases of five.
    pub p80: u64,
    /// Enough in nineteen cases of twenty.
    pub p95: u64,
}

/// How sure the user wants to be that the capacity is enough.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Confidence {
    /// As likely as not.
    P50,
    /// Four cases of five.
    #[default]
    P80,
    /// Nineteen cases of twenty.
    P95,
}

/// Someone with a share of the farm.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Project {
    /// Identity.
    pub id: u64,
    /// Name for people.
    pub name: String,
    /// Its share, relative to the others'; zero counts as one.
    pub share: u32,
    /// What it had.
    pub usage: Vec<Usage>,
}

/// Node time that a project had.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Usage {
    /// When it ended.
    pub at: i64,
    /// Microseconds of a node.
    pub time: i64,
}

impl Confidence {
    /// The standard normal variable that is below this with this probability.
    pub fn z(self) -> f64 {
        match self {
            Confidence::P50 => 0.0,
            Confidence::P80 => Z80,
            Confidence::P95 => Z95,
        }
    }

    /// The probability.
    pub fn probability(self) -> f64 {
        match self {
            Confidence::P50 => 0.5,
            Confidence::P80 => 0.8,
            Confidence::P95 => 0.95,
        }
    }
}

/// Standard deviation of the logarithm, from median and P80; zero if they say nothing.
fn log_spread(p50: u64, p80: u64) -> f64 {
    if p50 == 0 || p80 <= p50 { 0.0 } else { libm::log(p80 as f64 / p50 as f64) / Z80 }
}

impl WorkTotal {
    /// The quantile of this confidence.
    pub fn at(&self, confidence: Confidence) -> u64 {
        match confidence {
            Confidence::P50 => self.p50,
            Confidence::P80 => self.p80,
            Confidence::P95 => self.p95,
        }
    }
}

impl Job {
    /// Work bought for each frame: its median, scaled so that all frames together reach the job's total at
    /// its confidence, and rounded up.
    ///
    /// The forecast error that all frames share does not average out, so the whole job is scaled by one
    /// factor. The sum of the frames' own quantiles would buy too much, the sum of their medians would be
    /// late every other time.
    pub fn bought_work(&self) -> Vec<u64> {
        let medians = self.medians();
        self.frames
            .iter()
            .map(|frame| match medians {
                // Nothing is known of the frames: they share evenly.
                0 => self.share(1, self.frames.len() as u128),
                _ => self.share(frame.work, medians),
            })
            .collect()
    }

    /// What the work of all frames is multiplied by when what they have in common comes out at this z, as a multiple of the
    /// median: straight lines between the logarithms of the total's P50, P80 and P95, continued at both ends.
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

    /// Standard deviation of the logarithm of a frame's own factor: of its work, less what all frames have in common.
    pub fn own_spread(&self, frame: &Frame) -> f64 {
        let common = log_spread(self.total.p50, self.total.p80);
        libm::sqrt(f64::max(0.0, libm::pow(log_spread(frame.work, frame.work_p80), 2.0) - common * common))
    }

    /// Number and bought work of the frames that still need a place.
    pub fn open_work(&self) -> impl Iterator<Item = (i64, u64)> {
        let done: std::collections::BTreeSet<i64> = self.done.iter().copied().collect();
        let all = self.frames.iter().map(|frame| frame.number).zip(self.bought_work());
        all.filter(move |(number, _)| !done.contains(number))
    }

    /// Work bought for the whole shared cache: its median, scaled as the frames are.
    pub fn bought_shared_cache(&self) -> Option<u64> {
        let cache = self.shared_cache?;
        Some(match self.medians() {
            0 => cache.work,
            medians => self.share(cache.work, medians),
        })
    }

    /// Work bought for one of the shared cache's tasks, if it is one.
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

    /// What the job counts among jobs of its priority.
    pub(crate) fn worth(&self) -> u32 {
        self.weight.max(1)
    }
}
