//! The farm over HTTP: routes, roles, events, dashboard, and the conductor that moves jobs from one state to
//! the next.
//!
//! [`Service::start`] opens the store and spawns three tasks. One serves requests ([`router`](self) lists
//! every address). One sweeps expired leases. The third is the conductor: it hears of every committed preview
//! and profile and decides what follows. All state that matters is in the store, so a restart continues where
//! the process died.

mod background;
mod budget_forecast;
mod bundle_inspection;
mod clock;
mod conditions;
mod conductor;
mod config;
mod connections;
mod cookies;
mod costly;
mod delivery;
mod disk_space;
mod document;
mod error;
mod extract;
mod feed;
mod inspector;
mod low_priority;
mod metrics;
mod oidc;
mod openapi;
mod output_root;
mod outputs;
mod paced_body;
mod page;
mod plan_difference;
mod plot;
mod quotas;
mod resources;
mod rights;
mod router;
mod schema;
mod seen;
mod service;
mod shared;
mod sign_in;
mod state;
mod summaries;
mod uploads;
mod webhooks;

pub use budget_forecast::{BudgetForecastError, budget_forecast};
pub use clock::{Clock, ManualClock, SystemClock};
pub use config::{Config, ConnectionLimits, Evidence, Limits, TlsFiles, UploadLimits};
pub use inspector::{Inspection, inspect_bundle};
pub use oidc::{Grant, SignInProvider};
pub use router::openapi_yaml;
pub use service::{Service, ServiceError};
