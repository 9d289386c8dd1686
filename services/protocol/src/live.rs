//! The living estimate: what a job will have cost, as its frames are finished.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{Confidence, JobId, JobState, Money, MoneyQuantiles, Quantiles, Timestamp};

/// One number of the estimate, beside the quote.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct LiveFigure {
    /// What was quoted for the whole job; it never changes.
    pub quote: Quantiles,
    /// What all that is finished took.
    pub spent: f64,
    /// What the rest is expected to take.
    pub remaining: Quantiles,
    /// What the whole job is expected to take: the quote before anything is finished, the truth after the last frame.
    pub whole: Quantiles,
    /// Median of what remains over what was quoted for it: 1.3 if the job turns out 30 % dearer.
    pub factor: f64,
}

impl LiveFigure {
    /// Nothing more will be spent: what is done is all.
    pub fn give_up(&mut self) {
        *self = Self {
            remaining: Quantiles::default(),
            whole: Quantiles::known(self.spent),
            factor: 1.0,
            ..*self
        };
    }
}

/// What is booked for a job: what its living estimate is held against.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Booked {
    /// How sure the job's plan is to be, and so the quantile of all that is compared.
    pub confidence: Confidence,
    /// CPU seconds at that confidence when the plan was made, on a node of speed 1.
    pub cpu_seconds: f64,
    /// What the bookings cost; absent if there are none.
    pub cost: Option<Money>,
    /// When the last of them ends; absent if there are none.
    pub finish: Option<Timestamp>,
}

/// A job's living estimate. The quote beside it stays what it was: past quotes are judged, not what was made of them later.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct LiveForecast {
    /// When it was made.
    pub at: Timestamp,
    /// Frames that were finished then.
    pub frames_done: u32,
    /// Deterministic count of operations.
    pub work: LiveFigure,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: LiveFigure,
    /// The whole job in money: what its nodes' time has cost until now, the quote and what was lost included, and the rest at the quote's mean price. After the last frame it is what the job has cost. Absent if it was quoted without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<MoneyQuantiles>,
    /// When the last frame is expected, at the plan's confidence; absent if nothing is booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<Timestamp>,
    /// What is booked.
    pub booked: Booked,
    /// Whether the job is expected to cost more than is booked, at the plan's confidence.
    pub cost_is_off: bool,
    /// Whether it is expected to end later than is booked, at the plan's confidence.
    pub finish_is_off: bool,
}

/// What an estimate can leave.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BookedQuantity {
    /// What the job costs.
    Cost,
    /// When it ends.
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

/// The numbers of an event that says that a job's estimate has left what is booked, or has come back to it.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct OffForecast {
    /// What left, or came back.
    pub quantity: BookedQuantity,
    /// Frames that were finished.
    pub frames_done: u32,
    /// What is booked, and how sure it was to be.
    pub booked: Booked,
    /// CPU seconds that the whole job is expected to take, at that confidence, on a node of speed 1.
    pub cpu_seconds: f64,
    /// What the bookings would cost if they were as long as is now expected; absent if there are none.
    pub cost: Option<Money>,
    /// When the last frame is expected, at that confidence; absent if nothing is booked.
    pub finish: Option<Timestamp>,
}

/// The estimate at one moment of the job's life.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct HistoryPoint {
    /// When it was made.
    pub at: Timestamp,
    /// Frames that were finished then.
    pub frames_done: u32,
    /// What all that was finished had taken: count of operations.
    pub work_spent: f64,
    /// Count of operations of the whole job, as it was expected then.
    pub work: Quantiles,
    /// What all that was finished had taken: CPU seconds on a node of speed 1.
    pub cpu_spent: f64,
    /// CPU seconds of the whole job, as it was expected then.
    pub cpu_seconds: Quantiles,
    /// When the last frame was expected, at the plan's confidence; absent if nothing was booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<Timestamp>,
}

impl HistoryPoint {
    /// What is kept of an estimate.
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

/// How a job's estimate moved, from the quote to the truth.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ForecastHistory {
    /// The job.
    pub job_id: JobId,
    /// Where it stands.
    pub state: JobState,
    /// Frames in all.
    pub frames_total: u32,
    /// The estimate as it stands.
    pub now: LiveForecast,
    /// What it was at earlier moments, the quote first: at most 512. Each time that there would be more, every second one is left out.
    pub points: Vec<HistoryPoint>,
}
