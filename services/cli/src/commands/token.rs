//! `forelight token`: a new bearer token.

use crate::atomic_file;
use crate::failure::BadInput;
use crate::output;
use anyhow::{Context, Result};
use forelight_protocol::{Role, Timestamp};
use forelight_store::{Store, tokens};
use std::path::PathBuf;

/// Make a bearer token for a person or a worker
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight token --data farm-data --role submitter --name anna
  forelight token --data farm-data --role worker --name rack-7 --out rack-7.token

The token is shown or written once; the farm keeps only its hash. The service may be running.

Roles: viewer reads; submitter also submits jobs and bundles; worker also takes tasks; operator may do everything.")]
pub struct Args {
    /// Data folder of the farm
    #[arg(long, value_name = "DIR", default_value = "farm-data")]
    data: PathBuf,
    /// What its holder may do
    #[arg(long, value_name = "ROLE")]
    role: Role,
    /// Whom it is for
    #[arg(long, value_name = "NAME", default_value = "unnamed")]
    name: String,
    /// Write it to this file, readable by its owner alone, instead of showing it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Runs the command.
pub async fn run(args: Args) -> Result<()> {
    if args.name.trim().is_empty() || args.name.chars().count() > 200 {
        return Err(BadInput::new("--name: must have 1 to 200 characters").into());
    }
    if !args.data.is_dir() {
        return Err(BadInput::new(format!("--data {}: there is no such folder", args.data.display()))
            .hint("start the farm once; it makes its data folder")
            .into());
    }
    let store = Store::open_beside(&args.data)
        .await
        .with_context(|| format!("cannot open the farm's data in {}", args.data.display()))?;
    let token = tokens::create(&store, args.role, args.name.trim(), Timestamp::now()).await?;
    store.close().await;
    match &args.out {
        Some(path) => atomic_file::write_secret(path, token.as_bytes()),
        None => output::line(token),
    }
}
