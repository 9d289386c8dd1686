//! `forelight scrub`: verifies all artefacts of a farm.

use crate::data_folder;
use anyhow::{Context, Result, bail};
use forelight_protocol::Timestamp;
use forelight_protocol::words::{counted, is_or_are};
use forelight_store::{Scrubbed, Store};
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::{self, Bars};
use serde::Serialize;
use std::path::PathBuf;

/// Verify that all artefacts of a farm are still what was stored
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight scrub --data farm-data
  forelight scrub --data farm-data --json

Reads every image, profile, bundle and cache once, and compares it with its hash. The service may be running; it does \
the same by itself, slowly. Objects in a bucket are only asked for. What is damaged is listed, and told as an event. \
Bring it back from a backup of DATA/artifacts, or render its frames again. Ends with exit code 1 if anything is damaged.")]
pub struct Args {
    /// Data folder of the farm
    #[arg(long, value_name = "DIR", default_value = "farm-data")]
    data: PathBuf,
    /// Print what was found as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Default, Serialize)]
struct Document {
    artifacts: u64,
    bytes: u64,
    damaged: Vec<String>,
}

/// Bytes between two looks at whether the user wants to stop.
const AT_ONCE: u64 = 64 << 20;

pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    data_folder::check_farm("--data", &args.data)?;
    let failed = || format!("cannot scrub the artefacts in {}", args.data.display());
    let store = Store::open_beside_with_artifacts(&args.data).await.with_context(failed)?;
    let spinner = Bars::new(args.json).spinner("verifying artefacts");
    let mut found = Document::default();
    let mut after = None;
    loop {
        if interrupt.is_set() {
            return Err(Interrupted.into());
        }
        let Scrubbed { artifacts, bytes, damaged, next } =
            store.artifacts().scrub(after, AT_ONCE, Timestamp::now()).await.with_context(failed)?;
        found.artifacts += artifacts;
        found.bytes += bytes;
        found.damaged.extend(damaged);
        spinner.set_message(format!("verifying artefacts: {}", found.artifacts));
        after = next;
        if after.is_none() {
            break;
        }
    }
    spinner.finish_and_clear();
    store.close().await;
    if args.json {
        output::json(&found)?;
    } else {
        for damaged in &found.damaged {
            output::line(damaged)?;
        }
        let (artifacts, bytes) = (counted(found.artifacts, "artefact"), counted(found.bytes, "byte"));
        output::line(format!("verified: {artifacts} of {bytes}"))?;
    }
    match found.damaged.len() {
        0 => Ok(()),
        damaged => bail!(
            "{} {} damaged; bring back from a backup what is damaged, or render its frames again",
            counted(damaged, "artefact"),
            is_or_are(damaged)
        ),
    }
}
