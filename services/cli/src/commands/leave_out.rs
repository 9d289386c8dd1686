//! `forelight leave-out`: takes a job out of the track record, or puts it back.

use super::cancel::find_any;
use crate::connection::{ConnectionOptions, connect};
use anyhow::{Context, Result};
use forelight_protocol::LeaveOutRequest;
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
    let id = find_any(&client, &args.job).await?;
    let Some(reason) = args.reason else {
        client.put_back(id).await.with_context(|| format!("cannot put job {id} back"))?;
        return output::line(format!("job {id} is in the track record"));
    };
    let request = LeaveOutRequest { reason };
    let out = client.leave_out(id, &request).await.with_context(|| format!("cannot leave job {id} out"))?;
    output::line(format!("{} ({id}) is out of the track record: {}", out.name, out.reason))
}
