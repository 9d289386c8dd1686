//! Benches of the service: lease calls, and thousands of workers.

mod bare;
mod filling;
pub mod leases;
mod pages;
mod service;
mod siege;
pub mod workers;
