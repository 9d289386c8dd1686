//! Checks that the page was built, if it is to be embedded.

use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var_os("CARGO_FEATURE_PAGE").is_none() {
        return;
    }
    println!("cargo::rerun-if-changed=dist");
    if !Path::new("dist/index.html").is_file() {
        println!(
            "cargo::error=services/dashboard/dist/index.html is missing; build the page first: \
             cd services/dashboard && npm ci && npm run build"
        );
    }
}
