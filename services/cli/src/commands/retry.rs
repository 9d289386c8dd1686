//! `forelight retry`: renders frames of a job again.

use super::cancel::find_any;
use crate::connection::{ConnectionOptions, connect};
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_protocol::{FrameSet, FrameState, FramesRequest, JobId, JobState};
use forelight_terminal::failure::BadInput;
use forelight_terminal::output;

/// Render frames of a job again: those that failed, or those that you name
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight retry kitchen --data farm-data
  forelight retry kitchen --frames 0-3,17 --server http://farm:7878 --token-file me.token

A job that failed goes on with all frames that it had left; one that failed before it was booked, with its quote. \
A job that is done goes on with the named frames, and \
their images are replaced. `forelight status kitchen` says why the job failed.")]
pub struct Args {
    /// Id of the job. A name works if only one job has it
    job: String,
    /// Frames, such as 0-47 or 0,5,9-12; finished ones too [default: those that failed]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    /// Print the job as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let id = find_any(&client, &args.job).await?;
    let frames = match args.frames {
        Some(frames) => frames,
        None => left(&client, id).await?,
    };
    let request = FramesRequest { frames };
    let job = client.retry_frames(id, &request).await.with_context(|| format!("cannot retry job {id}"))?;
    if args.json {
        return output::json(&job);
    }
    if job.plan_id.is_none() {
        return output::line(format!("{} ({id}): its quote goes on", job.name));
    }
    let frames = &request.frames;
    let what =
        if frames.count() == 1 { format!("frame {frames} is") } else { format!("frames {frames} are") };
    output::line(format!("{} ({id}): {what} rendered again", job.name))
}

/// The frames that failed. Of a job that failed, also those that it had left: a part of them may have failed, or their
/// shared cache.
async fn left(client: &Client, id: JobId) -> Result<FrameSet> {
    let job = client.job(id).await.with_context(|| format!("cannot read job {id}"))?;
    if job.state == JobState::Failed && job.plan_id.is_none() {
        return Ok(job.frames);
    }
    let rows = client.frames(id).await.with_context(|| format!("cannot list the frames of job {id}"))?;
    let has_failed = job.state == JobState::Failed;
    let is_left = |state: FrameState| match state {
        FrameState::Failed => true,
        FrameState::Cancelled => has_failed,
        _ => false,
    };
    let left = rows.iter().filter(|row| is_left(row.state)).map(|row| row.frame);
    FrameSet::from_frames(left).ok_or_else(|| {
        let hint = "--frames names frames to render again, finished ones too";
        BadInput::new(format!("job {id} has no frame that failed")).hint(hint).into()
    })
}
