//! The service over HTTP, with its own data folder and workers with made-up results.

mod accuracy;
mod audit;
mod budgets;
mod calibration;
mod changes;
mod cost_limits;
mod delivery;
mod division;
mod document;
mod encryption;
mod events;
mod job_life;
mod lists;
mod living_estimate;
mod nodes;
mod outputs;
mod page;
mod plans;
mod quotas;
mod reach;
mod renderers;
mod requests;
mod results;
mod retention;
mod sessions;
#[path = "../support/mod.rs"]
mod support;
mod tokens;
mod trust;
mod turnover;
mod uploads;
mod versions;
mod videos;
mod wear;
mod webhooks;
mod workers;
