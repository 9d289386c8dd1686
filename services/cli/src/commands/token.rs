//! `forelight token`: creates a bearer token.

use anyhow::{Context, Result};
use forelight_protocol::{Role, Timestamp};
use forelight_store::{Store, tokens};
use forelight_terminal::atomic_file;
use forelight_terminal::failure::BadInput;
use forelight_terminal::options::duration;
use forelight_terminal::output;
use std::path::PathBuf;
use std::time::Duration;

/// Create a bearer token for a person or a worker
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight token --data farm-data --role submitter --name anna
  forelight token --data farm-data --role worker --name rack-7 --out rack-7.token
  forelight token --data farm-data --one-time --name rack-8 --out rack-8.join

The token is printed or written once; the farm keeps only its hash. The service may run meanwhile.

Roles:
  viewer      reads
  submitter   reads, and submits jobs and bundles
  worker      registers a node and takes tasks; reads nothing else
  operator    does everything

A one-time token lets one machine join the farm once: `forelight worker --join-token-file rack-8.join --token-file \
rack-8.token`. The machine then gets its own token, which is valid for its node only. To replace an existing node, \
give the one-time token the --name of that node.")]
pub struct Args {
    /// Data folder of the farm
    #[arg(long, value_name = "DIR", default_value = "farm-data")]
    data: PathBuf,
    /// Role of the token: viewer, submitter, worker or operator
    #[arg(long, value_name = "ROLE", required_unless_present = "one_time")]
    role: Option<Role>,
    /// Create a one-time token, with which one machine joins the farm as a node
    #[arg(long, conflicts_with = "role")]
    one_time: bool,
    /// Time for which a one-time token is valid, such as 24h
    #[arg(long, value_name = "DURATION", default_value = "24h", value_parser = duration, requires = "one_time")]
    valid: Duration,
    /// Name of the person or machine. A one-time token with a node's name lets a machine replace that node
    #[arg(long, value_name = "NAME", default_value = "unnamed")]
    name: String,
    /// Write the token to this file, readable by its owner alone, instead of printing it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}
pub async fn run(args: Args) -> Result<()> {
    if args.name.trim().is_empty() || args.name.chars().count() > 200 {
        return Err(BadInput::new("--name: a name has 1 to 200 characters").into());
    }
    if !args.data.is_dir() {
        return Err(BadInput::new(format!("--data {}: this folder does not exist", args.data.display()))
            .hint("start the farm once, which creates the folder, or name another folder")
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
