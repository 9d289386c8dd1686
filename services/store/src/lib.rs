//! What the farm remembers: jobs, tasks, leases, forecasts, plans, events in one SQLite database; images, profiles
//! and bundles as files named by their hash. Knows nothing of HTTP and nothing of tracing light.
//!
//! Three promises, and what keeps them:
//!
//! * **Nothing acknowledged is lost.** Every write is part of a transaction on one writing connection with
//!   `synchronous = FULL`: its commit is on disk before the caller hears of it, whether the process is killed or the
//!   power goes. Writes that come at the same time share a flush (`writing`). (With `NORMAL` a killed process loses nothing either, but a power cut takes the last commits. `FULL`
//!   costs a flush per commit, some thousand commits a second on a disk with a write cache; a farm makes a
//!   few per frame.) An artefact is flushed before its row is written, and a result names only artefacts with rows.
//! * **Two workers never hold the same task.** One writer at a time, `BEGIN IMMEDIATE`, and a unique index over the
//!   active leases that makes the database itself refuse.
//! * **A worker that lost its lease harms nothing.** Every hand-out raises the task's fencing token, and whatever is
//!   said with an older token is refused.
//!
//! Time is never read here: every function that needs it is given `now`.

mod artifacts;
mod backup;
mod bookings;
mod budgets;
mod bundles;
mod calibration;
mod checkpoints;
mod claims;
mod dashboard;
mod database;
mod decode;
mod elsewhere;
mod error;
mod events;
mod failures;
mod farm;
mod forecasts;
mod frames;
mod idempotency;
mod jobs;
mod joining;
mod leases;
mod live;
mod logs;
mod node_learning;
mod nodes;
mod plans;
mod policy;
mod progress;
mod projects;
mod replans;
mod results;
mod seeds;
mod slurm;
mod tasks;
pub mod tokens;
mod track_record;
mod unattended;
mod writing;

pub use artifacts::{ArtifactPlace, ArtifactReader, Artifacts, BadPlace, Staged};
pub use backup::{Backup, backup};
pub use budgets::{KeptNight, OpenJob};
pub use bundles::NewBundle;
pub use calibration::{QuoteBasis, QuoteKind, Spreads};
pub use database::{DATABASE, Store};
pub use error::StoreError;
pub use farm::{FarmFrame, FarmJob};
pub use forecasts::JobForecast;
pub use forelight_quote::living::is_news;
pub use idempotency::{Answered, IdempotencyKey, RecordedAnswer};
pub use jobs::{JobFilter, NewJob};
pub use joining::token_hash;
pub use leases::{LeaseInfo, Swept};
pub use nodes::LOST;
pub use plans::{JobOutlook, NewJobPlan, NewPlan};
pub use policy::availability::{Opening, as_it_is, free_time_of, opening, silence};
pub use policy::projection::{Holder, OpenBooking, OpenSeed, Projected, ProjectedSeed, Projection, project};
pub use policy::rebooking::NewBooking;
pub use policy::retries::{FAILED_JOBS, FAILED_NODES, MAX_EXPIRIES, MAX_FAILURES};
pub use policy::work_stealing::OVERDUE;
pub use projects::{HALF_LIFE, ProjectUse};
pub use replans::Wanted;
pub use results::{Committed, MeasuredProfile};
pub use seeds::{NewSeed, NewSeedBooking, PlannedCache};
pub use slurm::{BookedTime, Holding, NewArray, OpenArray, OpenElement, SeenNode, Waiting};
pub use track_record::FinishedJob;
pub use unattended::Unattended;

#[cfg(test)]
mod tests;
