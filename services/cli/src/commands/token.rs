//! `forelight token`: a new bearer token.

use anyhow::{Context, Result};
use forelight_protocol::{Role, Timestamp};
use forelight_store::{Store, tokens};
use forelight_terminal::atomic_file;
use forelight_terminal::failure::BadInput;
use forelight_terminal::options::duration;
use forelight_terminal::output;
use std::path::PathBuf;
use std::time::Duration;

/// Make a bearer token for a person or a worker
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight token --data farm-data --role submitter --name anna
  forelight token --data farm-data --role worker --name rack-7 --out rack-7.token
  forelight token --data farm-data --one-time --name rack-8 --out rack-8.join

The token is shown or written once; the farm keeps only its hash. The service may be running.

Roles: viewer reads; submitter also submits jobs and bundles; worker registers a node and takes tasks, and reads nothing else; operator may do everything.

A one-time token lets one machine join the farm, once: `forelight worker --join-token-file rack-8.join --token-file rack-8.token`. The \
machine gets a token of its own, which speaks for its node and no other. It takes the place of a node that is there already only with a \
one-time token whose --name is that node's.")]
pub struct Args {
    /// Data folder of the farm
    #[arg(long, value_name = "DIR", default_value = "farm-data")]
    data: PathBuf,
    /// What its holder may do
    #[arg(long, value_name = "ROLE", required_unless_present = "one_time")]
    role: Option<Role>,
    /// Make a one-time token, with which one machine can join the farm as a node
    #[arg(long, conflicts_with = "role")]
    one_time: bool,
    /// How long a one-time token may be used
    #[arg(long, value_name = "DURATION", default_value = "24h", value_parser = duration, requires = "one_time")]
    valid: Duration,
    /// Whom it is for; a one-time token in a node's name lets a machine take that node's place
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
    let (name, now) = (args.name.trim(), Timestamp::now());
    let token = match args.role {
        Some(role) => tokens::create(&store, role, name, now).await?,
        None => {
            let valid = i64::try_from(args.valid.as_micros()).unwrap_or(i64::MAX);
            store.create_join_token(name, valid, now).await?.token
        }
    };
    store.close().await;
    match &args.out {
        Some(path) => atomic_file::write_secret(path, token.as_bytes()),
        None => output::line(token),
    }
}
