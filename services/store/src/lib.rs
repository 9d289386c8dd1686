//! The farm's storage: jobs, tasks, leases, forecasts, plans and events in one SQLite database; images,
//! profiles and bundles as files named by their hash. It knows nothing of HTTP or of tracing light.
//!
//! Three promises, and how they are kept:
//!
//! * **Nothing acknowledged is lost.** Every write is part of a transaction on one writing connection with
//!   `synchronous = FULL`. Its commit is on disk before the caller is answered, so neither a killed process
//!   nor a power cut loses it. (`NORMAL` would lose the last commits in a power cut.) `FULL` costs a flush
//!   per commit. Disks with a write cache flush some thousand times a second, and a farm needs a few flushes
//!   per frame. Concurrent writes share a flush (`writing`). An artefact is flushed before its row is
//!   written, and a result names only artefacts with rows.
//! * **Two workers never hold the same task by mistake.** There is one writer at a time, with `BEGIN
//!   IMMEDIATE`. A unique index over the active leases makes the database itself refuse a second one, except
//!   the one that a stalled task is given beside the first. One of them is committed.
//! * **A worker that lost its lease does no harm.** Every hand-out raises the task's fencing token, and every
//!   message with an older token is refused.
//!
//! This crate never reads the clock: every function that needs the time takes `now`.

mod actor;
mod artifacts;
mod audit;
mod backup;
mod budgets;
mod bundles;
mod claims;
mod columns;
mod dashboard;
mod database;
mod division;
mod error;
mod events;
mod evidence;
mod idempotency;
mod jobs;
mod leases;
mod living;
mod nodes;
mod outputs;
mod people;
mod plans;
mod policy;
mod projects;
mod quotas;
mod quotes;
mod reach;
mod results;
mod retention;
mod rights;
mod sessions;
mod shared_cache;
mod slurm;
mod tasks;
mod timeline;
pub mod tokens;
mod videos;
mod webhooks;
mod writing;

pub use actor::Actor;
pub use artifacts::{ArtifactPlace, ArtifactReader, Artifacts, BadPlace, Scrubbed, Staged};
pub use audit::AuditFilter;
pub use backup::{Backup, backup};
pub use budgets::nights::KeptNight;
pub use bundles::NewBundle;
pub use database::{DATABASE, Store};
pub use error::StoreError;
pub use idempotency::{Answered, IdempotencyKey, RecordedAnswer};
pub use jobs::listing::{JobFilter, JobOrder, JobPlace};
pub use jobs::open_jobs::OpenJob;
pub use jobs::outlooks::{FinishSpread, JobOutlook};
pub use jobs::submitting::NewJob;
pub use leases::LeaseInfo;
pub use leases::sweeping::Swept;
pub use nodes::LOST;
pub use nodes::joining::token_hash;
pub use nodes::listing::{NodeFilter, NodeListing, NodeOrder, NodePlace};
pub use nodes::unattended::Unattended;
pub use outputs::DueOutput;
pub use people::{Person, Rights};
pub use plans::farm_jobs::{FarmFrame, FarmJob};
pub use plans::replans::Wanted;
pub use plans::{NewJobPlan, NewPlan};
pub use policy::availability::{Opening, as_it_is, free_time_of, opening, silence};
pub use policy::overdue::TaskAttempt;
pub use policy::projection::{
    Holder, JobEnds, OpenBooking, OpenCachePart, Projected, ProjectedCachePart, Projection, project,
};
pub use policy::rebooking::NewBooking;
pub use projects::{HALF_LIFE, ProjectUse};
pub use quotas::QuotaOf;
pub use quotes::profiling::ProfileVersion;
pub use quotes::track_record::FinishedJob;
pub use reach::ALL_PROJECTS;
pub use results::{Committed, ShotProfiles};
pub use rights::{EndOfRight, EndedRight};
pub use sessions::NewSession;
pub use shared_cache::parts::NewPartBooking;
pub use shared_cache::{NewSharedCache, PlannedCache};
pub use slurm::{BookedTime, Holding, NewArray, OpenArray, OpenElement, SeenNode, Waiting};
pub use timeline::Spans;

pub use webhooks::{Attempt, DueDelivery, NewDelivery, Receiver};

#[cfg(test)]
mod tests;
