//! The words on the wire: every type of forelight's REST API, once, for server, worker and command line.
//!
//! Conventions that hold everywhere:
//! * **Time** is [`Timestamp`]: integer microseconds UTC in memory and in the database, RFC 3339 with six
//!   fractional digits in JSON. Durations are integers that carry their unit in the name (`_nanos`, `_micros`, `_ms`).
//! * **Money** is [`Money`]: integer micro-units of the farm's one currency.
//! * **Work** is the renderer's deterministic count of operations, an integer on which two runs agree.
//! * **Ids** are UUIDs of version 7, so that they sort by age, each with a type of its own.
//! * **Enumerations** are snake_case strings. An enumeration that carries data is an object with one key, the
//!   variant's name (`{"render": {…}}`), because only then can an error in it be pointed at.
//! * Types that a client sends refuse unknown fields: a misspelt option is an error, not a silent default.

mod accuracy;
mod answers;
mod artifact;
mod budget;
mod bundle;
mod cache;
mod calendar;
mod calibration;
mod dashboard;
mod event;
mod explanation;
mod forecast;
mod frames;
mod hash;
mod ids;
mod job;
mod lease;
mod live;
mod log;
mod money;
mod node;
mod page;
mod plan;
mod problem;
mod profile;
mod result;
mod role;
mod settings;
mod stats;
mod task;
mod time;
mod track_record;

pub use accuracy::{
    AccuracyDoc, AccuracyRung, ImageError, LadderKind, Ladders, MeasuredRung, MissingLadder, NextRung,
};
pub use answers::{
    AnswersDoc, BudgetAnswer, MovedJob, OutlookLine, PlanChange, PlanEffect, PriceOffer, ProjectList,
    ProjectRequest, ProjectShare, Promise, QualityOffer, WaitKind, Waits,
};
pub use artifact::ArtifactStored;
pub use budget::{
    Budget, BudgetAction, BudgetChange, BudgetForecast, BudgetForecastRequest, BudgetList, BudgetOutlook,
    BudgetPeriod, BudgetRequest, BudgetThreshold, CostLine, LedgerLine, MoneyForecast, Night, NightForecast,
    NightRecord, NotReady,
};
pub use bundle::{Bundle, BundleRef, BundleSource, SceneSummary};
pub use cache::{
    CACHE_BYTES, CACHE_ROUNDS, CacheFillResult, CacheFillSpec, CacheFrame, CacheMergeResult, CacheMergeSpec,
    CachePlanResult, CachePlanSpec, CachePrice, CacheQuote, CacheSharing, PlanCount, SeedForecast,
    SeedProgress,
};
pub use calendar::{
    MOST_WINDOWS, MalformedCalendar, NodeCalendar, NodePower, NodeWindow, PowerState, TimeSpan, WindowEnd,
};
pub use calibration::{ByClass, KernelTime, NodeCalibration};
pub use dashboard::{Dashboard, DashboardCounts, DashboardJob, DashboardNode, NodeActivity, TaskCounts};
pub use event::{Event, EventKind};
pub use explanation::{
    Amounts, Explanation, Halving, ObjectShare, PartShare, ProfiledWork, RayShare, ShownWork,
};
pub use forecast::{
    Confidence, ForecastDoc, ForecastTotals, FrameForecast, MoneyQuantiles, NodeSeconds, Profiled, Quantiles,
    QuotedShot, RayQuantiles, SpentOnForecast,
};
pub use frames::{FrameSet, MalformedFrames};
pub use hash::{ArtifactHash, MalformedHash, SceneDigest};
pub use ids::{BookingId, BundleId, EventId, JobId, LeaseId, NodeId, PlanId, TaskId};
pub use job::{
    FrameArtifacts, FrameBooking, FrameFigure, FramePage, FrameRow, FrameState, Job, JobCheck, JobPage,
    JobRequest, JobState, Per, Within,
};
pub use lease::{
    CHECKPOINT_BYTES, ClaimRequest, FinishedPixels, Lease, LeaseOrder, ReleaseRequest, RenewRequest, Renewal,
    ResultAnswer, ResultRequest, TaskError, TaskLimit, TaskLimits,
};
pub use live::{
    Booked, BookedQuantity, ForecastHistory, HistoryPoint, LiveFigure, LiveForecast, OffForecast,
};
pub use log::{LOG_LINE_CHARACTERS, LOG_LINES, LogLevel, LogLine, TaskLog, TaskLogLine, without_secrets};
pub use money::Money;
pub use node::{
    Capabilities, JoinRequest, JoinToken, JoinTokenRequest, Node, NodeChange, NodePage, NodeRegistration,
    NodeState, NodeTerms,
};
pub use page::PageToken;
pub use plan::{
    Booking, BookingPage, FrameMove, FramePlace, JobVerdict, Plan, PlanDifference, PlanPage, PlanReason,
    PlanSummary, SeedBooking, Verdict, VerdictChange,
};
pub use problem::{Problem, ProblemKind};
pub use profile::{
    CacheSample, FixedCosts, NoiseCell, NoiseSample, ProcessCosts, ProfileArtifacts, ProfileResult,
    ProfileSample, SharedSample, UncoveredGathers, at_speed_one,
};
pub use result::{
    FrameStrata, PreviewBackend, PreviewResult, RenderArtifacts, RenderResult, Spent, Stratum, StratumName,
    TaskResult,
};
pub use role::{Role, UnknownRole};
pub use settings::{BadSetting, CacheMode, Integrator, MaterialMode, RenderSettings, RenderSettingsRequest};
pub use stats::{
    AllottedForecast, AllottedStats, BudgetClock, CacheStats, LeftOut, Rays, RenderStats, WithinStats,
};
pub use task::{PreviewSpec, ProfileSpec, RenderSpec, TaskKind, TaskSpec};
pub use time::{MalformedTime, Timestamp};
pub use track_record::{
    CalibratedQuantiles, CalibrationDoc, CalibrationKind, Corrections, Coverage, QuantileHits, TrackRecord,
    TrackRecordKind, TrackRecordRow,
};
