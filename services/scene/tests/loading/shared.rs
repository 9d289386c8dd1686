//! Where the shared test input lies.

use std::path::PathBuf;

/// A path under the shared folder (`FORELIGHT_SHARED`, by default `../shared` beside the repository). Prints a line
/// and gives nothing where it is missing, so that a checkout alone passes its tests.
pub fn shared(path: &str) -> Option<PathBuf> {
    let repository = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder =
        std::env::var_os("FORELIGHT_SHARED").map_or_else(|| repository.join("../shared"), PathBuf::from);
    let full = folder.join(path);
    if full.exists() {
        return Some(full);
    }
    println!(
        "skipped: {} is not there; set FORELIGHT_SHARED to the folder of shared test input",
        full.display()
    );
    None
}
