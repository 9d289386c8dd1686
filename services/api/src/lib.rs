//! The farm over HTTP: routes, roles, events, dashboard, and the conductor that takes jobs from one state to the next.
//!
//! A walk through: [`Service::start`] opens the store and spawns three tasks. One serves ([`router`](self) lists every
//! address; handlers are in `resources`, a file each, and do little: they check what came, ask the store, and
//! answer). One sweeps leases that have run out. One is the conductor, which is told of every preview and profile that was
//! committed, and decides what follows: which frames to profile, what the job will cost, who renders what and when.
//!
//! Nothing that matters is kept in the process: whatever it was doing when it died is found in the store at the next start.

mod answer_cache;
mod background;
mod budget_forecast;
mod bundle_inspection;
mod clock;
mod conductor;
mod config;
mod connections;
mod disk_space;
mod error;
mod extract;
mod metrics;
mod openapi;
mod page;
mod plan_difference;
mod plot;
mod resources;
mod router;
mod schema;
mod service;
mod state;

pub use budget_forecast::{BudgetForecastError, budget_forecast};
pub use clock::{Clock, ManualClock, SystemClock};
pub use config::{Config, Limits};
pub use router::openapi_yaml;
pub use service::{Service, ServiceError};
