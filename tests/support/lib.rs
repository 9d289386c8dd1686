//! Shared by several tests: reference images, statistics, worlds built in code, processes, HTTP, the
//! database, and networks, clocks and disks that fail.

pub mod bundles;
pub mod case;
pub mod events;
pub mod foreign;
pub mod http;
pub mod ledger;
pub mod parsers;
pub mod pictures;
pub mod processes;
pub mod proxy;
pub mod reference;
pub mod routes;
pub mod shim;
pub mod statistics;
pub mod waiting;
pub mod world;

use std::path::PathBuf;

/// The repository's root.
pub fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..")
}
