//! `forelight pause` and `forelight resume`: nothing more of a job is started for a while.

use super::cancel::each_job;
use crate::connection::{ConnectionOptions, connect};
use anyhow::{Context, Result};
use forelight_protocol::{Job, JobChange};

/// Pause jobs: nothing more of them is started, and their nodes are free for other jobs
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight pause kitchen --data farm-data
  forelight pause kitchen corridor --server http://farm:7878 --token-file me.token

What is being rendered goes on. `forelight retry kitchen --frames 12` takes frame 12 back from its worker; the \
frame is then rendered from the start. A paused job has no expected end, and its promised deadline is at risk. \
`forelight resume` has it planned anew, with its deadline and priority.")]
pub struct Args {
    #[command(flatten)]
    which: Which,
}

/// Resume paused jobs: they are planned anew, and go on
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight resume kitchen --data farm-data
  forelight resume kitchen corridor --server http://farm:7878 --token-file me.token")]
pub struct ResumeArgs {
    #[command(flatten)]
    which: Which,
}

#[derive(Debug, clap::Args)]
struct Which {
    /// Ids or names of the jobs. Of several jobs with a name, the only open one is meant
    #[arg(required = true, value_name = "JOB")]
    jobs: Vec<String>,
    /// Print the jobs as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn pause(args: Args) -> Result<()> {
    set(args.which, true).await
}

pub async fn resume(args: ResumeArgs) -> Result<()> {
    set(args.which, false).await
}

async fn set(which: Which, paused: bool) -> Result<()> {
    let client = connect(&which.connection)?;
    let (verb, did) = if paused { ("pause", "paused") } else { ("resume", "resumed") };
    let act = async |id, wanted: &str| {
        let change = JobChange { paused: Some(paused), ..JobChange::default() };
        client.change_job(id, &change).await.with_context(|| format!("cannot {verb} job {wanted}"))
    };
    each_job((&client, &which.jobs, which.json), did, act, line).await
}

fn line(job: &Job) -> String {
    let Job { name, id, frames_done, frames_total, .. } = job;
    let done = format!("{frames_done} of {frames_total} frames done");
    if job.paused {
        format!("{name} ({id}) is paused, {done}; `forelight resume {id}` lets it go on")
    } else {
        format!("{name} ({id}) is resumed, {done}; `forelight status {id}` shows its booking")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_how_to_go_on() {
        let mut job = crate::commands::status::tests::job();
        job.paused = true;
        let id = job.id;
        let said =
            format!("kitchen ({id}) is paused, 0 of 10 frames done; `forelight resume {id}` lets it go on");
        assert_eq!(line(&job), said);
        job.paused = false;
        assert!(line(&job).starts_with(&format!("kitchen ({id}) is resumed")), "{}", line(&job));
    }
}
