//! What several tests share: where test input lies, reference images, statistics, worlds
//! built in code; the program's processes, its API, its ledger; networks, clocks and disks that fail.

pub mod bundles;
pub mod case;
pub mod events;
pub mod http;
pub mod ledger;
pub mod parsers;
pub mod pictures;
pub mod processes;
pub mod proxy;
pub mod reference;
pub mod shim;
pub mod statistics;
pub mod waiting;
pub mod world;

use std::path::PathBuf;

/// The folder of shared test input: `FORELIGHT_SHARED`, or `../shared` beside the repository. `None`, with a line that says so,
/// where it is missing; the test then has nothing to do.
pub fn shared() -> Option<PathBuf> {
    let folder =
        std::env::var_os("FORELIGHT_SHARED").map_or_else(|| repository().join("../shared"), PathBuf::from);
    if folder.join("scenes").is_dir() {
        return Some(folder);
    }
    println!("skipped: no shared test input at {} (set FORELIGHT_SHARED)", folder.display());
    None
}

/// The repository's root.
pub fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..")
}
