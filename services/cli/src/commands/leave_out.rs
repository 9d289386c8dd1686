//! `forelight leave-out`: takes a job out of the track record, or puts it back.

use crate::connection::{ConnectionOptions, connect};
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_protocol::{JobId, LeaveOutRequest};
use forelight_terminal::failure::BadInput;
use forelight_terminal::output;

/// Take a job out of the track record, so that nothing is learnt from it
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight leave-out kitchen --reason 'node rack-7 reported wrong times' --data farm-data
  forelight leave-out 0192f0c1-7a3b-7c55-8f00-0123456789ab --undo --data farm-data

The track record lists the job with the reason. Calibration and the learnt speeds of nodes are as if it had \
never been rendered.")]
pub struct Args {
    /// Id of the job. A name works if only one job has it
    job: String,
    /// Why: kept with the job, and shown in the track record
    #[arg(long, value_name = "TEXT", required_unless_present = "undo", conflicts_with = "undo")]
    reason: Option<String>,
    /// Put the job back into the track record
    #[arg(long)]
    undo: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let id = find(&client, &args.job).await?;
    let Some(reason) = args.reason else {
        client.put_back(id).await.with_context(|| format!("cannot put job {id} back"))?;
        return output::line(format!("job {id} is in the track record"));
    };
    let request = LeaveOutRequest { reason };
    let out = client.leave_out(id, &request).await.with_context(|| format!("cannot leave job {id} out"))?;
    output::line(format!("{} ({id}) is out of the track record: {}", out.name, out.reason))
}

/// The id of the job with this id, or of the only job with this name. Most of them are done.
async fn find(client: &Client, wanted: &str) -> Result<JobId> {
    if let Ok(id) = wanted.parse() {
        return Ok(id);
    }
    let named = client.jobs_named(wanted).await.context("cannot list the jobs")?;
    match named.as_slice() {
        [job] => Ok(job.id),
        [] => Err(BadInput::new(format!("{wanted}: no job has this name"))
            .hint("`forelight jobs` lists them")
            .into()),
        several => {
            let ids: Vec<String> = several.iter().map(|job| job.id.to_string()).collect();
            Err(BadInput::new(format!("{wanted}: {} jobs have this name", several.len()))
                .hint(format!("name one by its id: {}", ids.join(" ")))
                .into())
        }
    }
}
