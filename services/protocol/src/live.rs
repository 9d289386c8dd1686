//! The live estimate: the cost of a running job, updated as its frames finish.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{Confidence, JobId, JobState, Money, MoneyQuantiles, Quantiles, Timestamp};

/// One number of the live estimate, beside the quote.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct LiveFigure {
    /// The quote of the whole job. It never changes.
    pub quote: Quantiles,
    /// Cost of everything that is finished.
    pub spent: f64,
    /// Forecast cost of the rest.
    pub remaining: Quantiles,
    /// Forecast cost of the whole job. It starts at the quote and ends at the true cost.
    pub whole: Quantiles,
    /// Forecast median of the rest over its quoted median. 1.3 means 30 % more expensive than quoted.
    pub factor: f64,
}

impl LiveFigure {
    /// Ends the estimate: nothing more will be spent.
    pub fn give_up(&mut self) {
        *self = Self {
            remaining: Quantiles::default(),
            whole: Quantiles::known(self.spent),
            factor: 1.0,
            ..*self
        };
    }
}

/// What is booked for a job. The live estimate is compared with it.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Booked {
    /// Confidence of the job's plan. All comparisons use this quantile.
    pub confidence: Confidence,
    /// CPU seconds at that confidence when the plan was made, on a node of speed 1.
    pub cpu_seconds: f64,
    /// Cost of the bookings. Absent if there are none.
    pub cost: Option<Money>,
    /// End of the last booking. Absent if there are none.
    pub finish: Option<Timestamp>,
}

/// The live estimate of a job. It does not change the quote, which alone enters the track record.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct LiveForecast {
    /// When the estimate was made.
    pub at: Timestamp,
    /// Number of frames that were finished then.
    pub frames_done: u32,
    /// Deterministic count of operations.
    pub work: LiveFigure,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: LiveFigure,
    /// Cost of node time so far, with the quote and lost work, plus the rest at the quote's mean price.
    /// Absent if the quote has no cost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<MoneyQuantiles>,
    /// Expected finish of the last frame, at the plan's confidence. Absent if nothing is booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<Timestamp>,
    /// What is booked.
    pub booked: Booked,
    /// Whether the job is expected to cost more than is booked, at the plan's confidence.
    pub cost_is_off: bool,
    /// Whether the job is expected to finish later than is booked, at the plan's confidence.
    pub finish_is_off: bool,
}

/// A quantity that is compared with what is booked.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BookedQuantity {
    /// Cost of the job.
    Cost,
    /// Finish of the job.
    Finish,
}

impl BookedQuantity {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            BookedQuantity::Cost => "cost",
            BookedQuantity::Finish => "finish",
        }
    }
}

/// The numbers of an event about a live estimate that exceeds what is booked, or is back within it.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct OffForecast {
    /// The quantity.
    pub quantity: BookedQuantity,
    /// Number of finished frames.
    pub frames_done: u32,
    /// What is booked, and the confidence of the plan.
    pub booked: Booked,
    /// Expected CPU seconds of the whole job at that confidence, on a node of speed 1.
    pub cpu_seconds: f64,
    /// Cost of the bookings if they had the length that is now expected. Absent if there are none.
    pub cost: Option<Money>,
    /// Expected finish of the last frame at that confidence. Absent if nothing is booked.
    pub finish: Option<Timestamp>,
}

/// The live estimate at one moment in the past.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct HistoryPoint {
    /// When the estimate was made.
    pub at: Timestamp,
    /// Number of frames that were finished then.
    pub frames_done: u32,
    /// Work of everything that was finished: count of operations.
    pub work_spent: f64,
    /// Forecast work of the whole job: count of operations.
    pub work: Quantiles,
    /// CPU seconds of everything that was finished, on a node of speed 1.
    pub cpu_spent: f64,
    /// Forecast CPU seconds of the whole job, on a node of speed 1.
    pub cpu_seconds: Quantiles,
    /// Expected finish of the last frame, at the plan's confidence. Absent if nothing was booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<Timestamp>,
}

impl HistoryPoint {
    /// The part of an estimate that is kept in the history.
    pub const fn of(live: &LiveForecast) -> Self {
        Self {
            at: live.at,
            frames_done: live.frames_done,
            work_spent: live.work.spent,
            work: live.work.whole,
            cpu_spent: live.cpu_seconds.spent,
            cpu_seconds: live.cpu_seconds.whole,
            finish: live.finish,
        }
    }
}

/// How a job's estimate moved, from the quote to the true cost.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ForecastHistory {
    /// The job.
    pub job_id: JobId,
    /// State of the job.
    pub state: JobState,
    /// Number of frames.
    pub frames_total: u32,
    /// The present estimate.
    pub now: LiveForecast,
    /// Earlier estimates, the quote first. Beyond 512, every second one is dropped.
    pub points: Vec<HistoryPoint>,
}
