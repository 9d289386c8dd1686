//! The resources: a file or folder each, with a small handler per verb.

pub(crate) mod answers;
pub(crate) mod artifacts;
pub(crate) mod audit;
pub(crate) mod budgets;
pub(crate) mod bundles;
mod checks;
pub(crate) mod dashboard;
pub(crate) mod events;
pub(crate) mod forecasts;
pub(crate) mod frames;
pub(crate) mod health;
pub(crate) mod jobs;
pub(crate) mod leases;
pub(crate) mod left_out;
pub(crate) mod nodes;
pub(crate) mod page;
pub(crate) mod plans;
pub(crate) mod projects;
pub(crate) mod responses;
pub(crate) mod retention;
pub(crate) mod sessions;
pub(crate) mod sign_in;
pub(crate) mod strip;
pub(crate) mod tasks;
pub(crate) mod timeline;
pub(crate) mod tokens;
pub(crate) mod webhooks;
