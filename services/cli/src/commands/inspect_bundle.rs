//! `forelight inspect-bundle`: loads a bundle for a service that runs this as a process of its own.

use anyhow::{Context, Result};
use forelight_terminal::output;
use std::path::PathBuf;

/// Load a bundle, and print what is in it as JSON
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Limits of a scene, as JSON
    limits: String,
    /// The bundle
    bundle: PathBuf,
}

pub fn run(args: &Args) -> Result<()> {
    let found = forelight_api::inspect_bundle(&args.limits, &args.bundle);
    output::json_line(&found.context("the limits are not JSON")?)
}
