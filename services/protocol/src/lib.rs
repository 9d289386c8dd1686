//! All types of forelight's REST API, defined once for server, worker and command line.
//!
//! The doc comments of these types are the descriptions in `openapi.yaml`. These conventions hold everywhere:
//!
//! * **Time** is [`Timestamp`]: integer microseconds UTC, RFC 3339 with six fractional digits in JSON.
//!   Durations are integers with the unit in their name (`_nanos`, `_micros`, `_ms`).
//! * **Money** is [`Money`]: integer micro-units of the farm's one currency.
//! * **Work** is the renderer's count of operations: an integer, the same in every run.
//! * **Ids** are UUIDs of version 7, so they sort by age. Each kind of id has its own type.
//! * **Enumerations** are snake_case strings. A variant with data is an object with one key, its name
//!   (`{"render": {…}}`), so an error can point to a place inside of it.
//! * **Absent values** are omitted or `null`. Clients should treat both alike.
//! * **Unknown fields** in requests are errors, so a misspelt option is never ignored.

mod accuracy;
mod answers;
mod artifact;
mod audit;
mod budget;
mod bundle;
mod cache;
mod calendar;
mod calibration;
mod confidence;
mod dashboard;
mod division;
mod error_target;
mod event;
mod explanation;
mod fixed_costs;
mod forecast;
mod frame;
mod frames;
mod hash;
mod ids;
mod job;
mod job_state;
mod lease;
mod left_out;
mod live;
mod log;
mod money;
mod needs;
mod node;
mod output;
mod page;
mod plan;
mod problem;
mod profile;
mod quantiles;
mod quota;
mod renderer;
mod result;
mod retention;
mod role;
mod session;
mod settings;
mod spent;
mod stats;
mod stratum;
mod task;
mod task_list;
mod time;
mod timeline;
mod token;
mod track_record;
mod version;
mod video;
mod webhook;
pub mod words;

pub use accuracy::{
    AccuracyDoc, AccuracyRung, DenoisedRung, ImageError, LadderKind, Ladders, MeasuredRung, MissingLadder,
    NextRung,
};
pub use answers::{
    AnswersDoc, BudgetAnswer, MovedJob, OutlookLine, PlanChange, PlanEffect, PriceOffer, ProjectList,
    ProjectRequest, ProjectShare, Promise, QualityOffer, WaitKind, Waits, WhatIf, WhatIfRequest,
};
pub use artifact::ArtifactStored;
pub use audit::{AuditAction, AuditEntry, AuditPage, UnknownAction};
pub use budget::{
    Budget, BudgetAction, BudgetChange, BudgetForecast, BudgetForecastRequest, BudgetHold, BudgetList,
    BudgetOutlook, BudgetPeriod, BudgetRequest, BudgetThreshold, CostLine, LedgerLine, MoneyForecast, Night,
    NightForecast, NightRecord, NotReady,
};
pub use bundle::{Bundle, BundleRef, BundleSource, SceneSummary};
pub use cache::{
    CACHE_BYTES, CACHE_ROUNDS, CacheFillResult, CacheFillSpec, CacheFrame, CacheMergeResult, CacheMergeSpec,
    CachePlanResult, CachePlanSpec, CachePrice, CacheQuote, CacheSharing, PlanCount, SharedCacheForecast,
    SharedCacheProgress,
};
pub use calendar::{
    MOST_WINDOWS, MalformedCalendar, NodeCalendar, NodePower, NodeWindow, PowerState, TimeSpan, WindowEnd,
};
pub use calibration::{ByClass, KernelTime, NodeCalibration};
pub use confidence::Confidence;
pub use dashboard::{
    Dashboard, DashboardCounts, DashboardJob, DashboardNode, FarmSummary, FarmVersions, FinishQuantiles,
    JobCounts, NodeActivity, NodeCounts, ProjectSpending, TaskCounts, WorkerVersion,
};
pub use division::{
    DivideResult, DivideSpec, Division, FinishedPart, FrameCache, FramePart, MOST_PARTS, PartCount, PartPass,
    PartPixels, PartRange, Passes, PixelRange, RenderPartResult, RenderPartSpec, RestOfPart, SampleRange,
};
pub use error_target::{ErrorTarget, SamplesForError};
pub use event::{Event, EventKind, FrameCost, JobNews, JobTerms};
pub use explanation::{Explanation, Halving, ObjectShare, PartShare, RayShare};
pub use fixed_costs::{FixedCosts, ProcessCosts};
pub use forecast::{
    ForecastDoc, ForecastTotals, FrameForecast, NodeSeconds, Profiled, QuotedShot, RayQuantiles,
    SpentOnForecast, StorageForecast,
};
pub use frame::{
    FrameArtifacts, FrameBooking, FrameFigure, FrameOutput, FramePage, FrameRow, FrameState, FramesRequest,
};
pub use frames::{FrameSet, MalformedFrames};
pub use hash::{ArtifactHash, MalformedHash, SceneDigest};
pub use ids::{
    BookingId, BundleId, DeliveryId, EventId, JobId, LeaseId, NodeId, PlanId, SessionId, TaskId, TokenId,
    WebhookId,
};
pub use job::{AcceptRequest, Failing, Job, JobChange, JobCheck, JobPage, JobRequest, Per, Within};
pub use job_state::JobState;
pub use lease::{
    CHECKPOINT_BYTES, ClaimRequest, FailureKind, FinishedPixels, Lease, LeaseOrder, ReleaseRequest,
    RenewRequest, Renewal, ResultAnswer, ResultRequest, TaskError, TaskLimit, TaskLimits,
};
pub use left_out::LeftOut;
pub use live::{
    Booked, BookedQuantity, ForecastHistory, HistoryPoint, LiveFigure, LiveForecast, OffForecast,
};
pub use log::{LOG_LINE_CHARACTERS, LOG_LINES, LogLevel, LogLine, TaskLog, TaskLogLine, without_secrets};
pub use money::Money;
pub use needs::{Needs, WITH_DENOISER};
pub use node::{
    Capabilities, JoinRequest, JoinToken, JoinTokenRequest, Node, NodeChange, NodePage, NodeRegistration,
    NodeState, NodeTerms,
};
pub use output::{NoPattern, OutputOf, OutputPattern};
pub use page::PageToken;
pub use plan::{
    Booking, BookingPage, FrameMove, FramePlace, JobVerdict, Plan, PlanDifference, PlanPage, PlanReason,
    PlanSummary, SharedCacheBooking, Verdict, VerdictChange,
};
pub use problem::{Problem, ProblemKind};
pub use profile::{
    CacheSample, NoiseCell, NoiseSample, ProfileArtifacts, ProfileResult, ProfileSample, SharedSample,
    UncoveredGathers,
};
pub use quantiles::{MoneyQuantiles, Quantiles};
pub use quota::{Quota, QuotaList, QuotaRequest};
pub use renderer::{JobSettings, OWN_RENDERER, RenderedBy, RendererId, RendererRequest, ShotSettings};
pub use result::{
    Described, FixedPart, FrameStrata, MeasuredFrame, MeasuredShare, PreviewBackend, PreviewResult,
    RenderArtifacts, RenderResult, SampleCost, StratumTime, TaskResult, Varied,
};
pub use retention::{Files, PruneRequest, Pruned, PrunedKind, Retention, RetentionKind, RetentionRule};
pub use role::{Role, UnknownRole};
pub use session::{Session, SessionCode, SessionPage, SessionRequest, SignInWays};
pub use settings::{BadSetting, CacheMode, Integrator, MaterialMode, RenderSettings, RenderSettingsRequest};
pub use spent::{Spent, at_speed_one};
pub use stats::{
    AllottedForecast, AllottedStats, BudgetClock, CacheChoice, CacheStats, DenoisedStats, Rays, RenderStats,
    WithinStats,
};
pub use stratum::{Stratum, StratumName};
pub use task::{PreviewSpec, ProfileSpec, RenderSpec, SampleShare, TaskKind, TaskSpec};
pub use task_list::{TaskPage, TaskRow};
pub use time::{MalformedTime, Timestamp, duration_in_words};
pub use timeline::{FrameStrip, JobName, SpanKind, StripQuantity, TimelineNode, TimelinePage, TimelineSpan};
pub use token::{NewToken, RotateRequest, Token, TokenChange, TokenKind, TokenPage, TokenRequest};
pub use track_record::{
    CalibratedQuantiles, CalibrationDoc, CalibrationKind, Corrections, Coverage, LeaveOutRequest, LeftOutJob,
    QuantileHits, TrackRecord, TrackRecordDay, TrackRecordKind, TrackRecordProject, TrackRecordRow,
};
pub use version::{OLDEST_WORKER_PROTOCOL, WORKER_PROTOCOL, WORKER_PROTOCOL_HEADER};
pub use video::{
    FrameRate, JobVideo, VIDEO_BYTES, VIDEO_FRAMES, VideoFile, VideoRequest, VideoResult, VideoSpec,
};
pub use webhook::{
    Delivery, DeliveryPage, DeliveryState, Webhook, WebhookData, WebhookKind, WebhookList, WebhookMessage,
    WebhookRequest,
};

/// Whether a number is left out of JSON.
fn is_zero<T: Default + PartialEq>(number: &T) -> bool {
    *number == T::default()
}
