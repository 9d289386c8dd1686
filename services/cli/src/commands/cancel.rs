//! `forelight cancel`: jobs that nobody wants any more.

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_protocol::{Job, JobId};
use forelight_terminal::failure::BadInput;
use forelight_terminal::output;

/// Cancel jobs: their workers stop, and what was booked for them is free for others
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight cancel 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data
  forelight cancel kitchen corridor --server http://farm:7878 --token-file me.token

Frames that are done are kept, and can still be fetched. A job that is cancelled cannot go on: submit it anew. Cancelling it twice is \
cancelling it once.")]
pub struct Args {
    /// Their ids, or their names where only one job of a name is not over
    #[arg(required = true, value_name = "JOB")]
    jobs: Vec<String>,
    /// Print the jobs as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Runs the command.
pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    // A name that fits none, or several, stops all before anything is done.
    let mut wanted = Vec::with_capacity(args.jobs.len());
    for job in &args.jobs {
        wanted.push(find(&client, job).await?);
    }
    let mut cancelled = Vec::with_capacity(wanted.len());
    for id in wanted {
        let job = client.cancel(id).await.with_context(|| format!("cannot cancel job {id}"))?;
        if !args.json {
            let (done, all) = (job.frames_done, job.frames_total);
            output::print(&format!(
                "{} ({id}) is {}; {done} of {all} frames were done\n",
                job.name, job.state
            ))?;
        }
        cancelled.push(job);
    }
    if args.json { output::json(&cancelled) } else { Ok(()) }
}

/// The job of this id, or the only one of this name that is not over.
async fn find(client: &Client, wanted: &str) -> Result<JobId> {
    if let Ok(id) = wanted.parse() {
        return Ok(id);
    }
    let named = client.jobs_named(wanted).await.context("cannot list the jobs")?;
    only_one(wanted, &named).map_err(Into::into)
}

fn only_one(wanted: &str, named: &[Job]) -> Result<JobId, BadInput> {
    let open: Vec<&Job> = named.iter().filter(|job| !job.state.is_final()).collect();
    match open.as_slice() {
        [job] => Ok(job.id),
        [] => {
            let which = if named.is_empty() {
                "there is no job of this name"
            } else {
                "all jobs of this name are over"
            };
            Err(BadInput::new(format!("{wanted}: {which}")).hint("`forelight jobs` lists them"))
        }
        several => {
            let ids: Vec<String> = several.iter().map(|job| job.id.to_string()).collect();
            Err(BadInput::new(format!("{wanted}: {} jobs of this name are not over", several.len()))
                .hint(format!("say which: {}", ids.join(" "))))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::only_one;
    use crate::commands::status::tests::job;
    use forelight_protocol::{Job, JobId, JobState};

    fn of(state: JobState) -> Job {
        Job { id: JobId::new(), state, ..job() }
    }

    #[test]
    fn a_name_is_enough_where_one_job_is_not_over() {
        let [done, open] = [JobState::Done, JobState::Rendering].map(of);
        assert_eq!(
            only_one("kitchen", &[done.clone(), open.clone()]).map_err(|error| error.to_string()),
            Ok(open.id)
        );
        let refused = |jobs: &[Job]| only_one("kitchen", jobs).unwrap_err().to_string();
        assert_eq!(refused(&[]), "kitchen: there is no job of this name");
        assert_eq!(refused(&[done]), "kitchen: all jobs of this name are over");
        assert_eq!(
            refused(&[open.clone(), of(JobState::Previewing)]),
            "kitchen: 2 jobs of this name are not over"
        );
    }
}
