//! The service's REST API as typed calls, one file per subject.

mod artifacts;
mod audit;
mod events;
mod farm;
mod jobs;
mod leases;
mod nodes;
mod quotas;
mod sessions;
mod tokens;
mod webhooks;

pub use events::EventStream;
pub use jobs::FramePicture;
pub use leases::Claimed;
