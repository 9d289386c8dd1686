//! `forelight cancel`: ends jobs before they are done.

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use crate::named::{JOBS, Kind, each, job_id, the_one};
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_protocol::words::counted;
use forelight_protocol::{Job, JobId};
use forelight_terminal::failure::BadInput;
use forelight_terminal::output;
use std::cell::RefCell;

/// Cancel jobs: their workers stop, and their bookings become free
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight cancel 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data
  forelight cancel kitchen corridor --server http://farm:7878 --token-file me.token

Finished frames stay available. A cancelled job cannot continue; submit it again instead. Cancelling a job \
again changes nothing. If one of several jobs cannot be cancelled, the others still are, and the exit code is 1.")]
pub struct Args {
    /// Ids or names of the jobs. Of several jobs with a name, the only open one is meant
    #[arg(required = true, value_name = "JOB")]
    jobs: Vec<String>,
    /// Print the cancelled jobs as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}
pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let act = async |id, wanted: &str| {
        client.cancel(id).await.with_context(|| format!("cannot cancel job {wanted}"))
    };
    each_job((&client, &args.jobs, args.json), "cancelled", act, |job| {
        let done = format!("{} of {}", job.frames_done, counted(job.frames_total, "frame"));
        format!("{} ({}) is {}; {done} done", job.name, job.id, job.state)
    })
    .await
}

/// Does the same to all of several open jobs, each for itself. Prints a line for each of them, or all as JSON.
pub(super) async fn each_job(
    (client, wanted, json): (&Client, &[String], bool),
    did: &str,
    act: impl AsyncFn(JobId, &str) -> Result<Job>,
    line: impl Fn(&Job) -> String,
) -> Result<()> {
    let jobs = RefCell::new(Vec::with_capacity(wanted.len()));
    let outcome = each(wanted, did, async |wanted: &str| {
        let job = act(find(client, wanted).await?, wanted).await?;
        if !json {
            output::line(line(&job))?;
        }
        jobs.borrow_mut().push(job);
        Ok(())
    })
    .await;
    if json && (outcome.is_ok() || wanted.len() > 1) {
        output::json(&jobs.into_inner())?;
    }
    outcome
}

const OPEN_JOBS: Kind = Kind { several: "open jobs have this name", ..JOBS };

/// The id of the job with this id, or of the only open job with this name, or of the only one.
pub(super) async fn find(client: &Client, wanted: &str) -> Result<JobId> {
    if let Some(id) = job_id(wanted)? {
        return Ok(id);
    }
    let named = client.jobs_named(wanted).await.context("cannot list the jobs")?;
    only_one(wanted, named).map_err(Into::into)
}

/// The id of the job with this id, or of the only job with this name, open or not.
pub(super) async fn find_any(client: &Client, wanted: &str) -> Result<JobId> {
    if let Some(id) = job_id(wanted)? {
        return Ok(id);
    }
    let named = client.jobs_named(wanted).await.context("cannot list the jobs")?;
    id_of(wanted, named, &JOBS).map_err(Into::into)
}

fn only_one(wanted: &str, named: Vec<Job>) -> Result<JobId, BadInput> {
    let (open, ended): (Vec<Job>, Vec<Job>) = named.into_iter().partition(|job| !job.state.is_final());
    match (open.is_empty(), ended.as_slice()) {
        // The service says what can be done with it.
        (true, [only]) => Ok(only.id),
        (true, [_, ..]) => Err(OPEN_JOBS.missing(wanted, "all jobs with this name have ended")),
        _ => id_of(wanted, open, &OPEN_JOBS),
    }
}

fn id_of(wanted: &str, found: Vec<Job>, kind: &Kind) -> Result<JobId, BadInput> {
    the_one(wanted, found, kind, |job| job.id.to_string()).map(|job| job.id)
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
    fn a_name_is_enough_where_one_job_is_open() {
        let [done, open] = [JobState::Done, JobState::Rendering].map(of);
        assert_eq!(
            only_one("kitchen", vec![done.clone(), open.clone()]).map_err(|error| error.to_string()),
            Ok(open.id)
        );
        let refused = |jobs: &[Job]| only_one("kitchen", jobs.to_vec()).unwrap_err().to_string();
        assert_eq!(refused(&[]), "kitchen: no job has this name or id");
        assert_eq!(only_one("kitchen", vec![done.clone()]).map_err(|error| error.to_string()), Ok(done.id));
        assert_eq!(refused(&[done.clone(), done]), "kitchen: all jobs with this name have ended");
        assert_eq!(refused(&[open.clone(), of(JobState::Previewing)]), "kitchen: 2 open jobs have this name");
    }
}
