//! `forelight jobs`: the farm's jobs, newest first.

use super::status::bar;
use crate::connection::ConnectionOptions;
use crate::connection::connect;
use anyhow::{Context, Result};
use forelight_protocol::words::by_name;
use forelight_protocol::{Job, JobState, Timestamp};
use forelight_terminal::failure::BadInput;
use forelight_terminal::output;
use forelight_terminal::quantities::clock;
use forelight_terminal::table::{Align, Table};

/// List the farm's jobs with their progress, newest first
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight jobs --data farm-data
  forelight jobs --state rendering --project film --data farm-data
  forelight jobs --most 200 --json --server http://farm:7878

`forelight status JOB` shows more about one job. The mark `!` means that a job is late, or that its deadline is at risk.")]
pub struct Args {
    /// List only jobs in this state: previewing, profiling, quoted, booked, rendering, done, failed or
    /// cancelled
    #[arg(long, value_name = "STATE", value_parser = by_name::<JobState>)]
    state: Option<JobState>,
    /// List only jobs of this project
    #[arg(long, value_name = "NAME")]
    project: Option<String>,
    /// List at most this many jobs, the newest: 1 to 200
    #[arg(long, value_name = "COUNT", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=200))]
    most: u32,
    /// Print the jobs as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args) -> Result<()> {
    if args.project.as_deref() == Some("") {
        return Err(BadInput::new("--project: the name is empty").into());
    }
    let client = connect(&args.connection)?;
    let state = args.state.map(|state| ("state", state.name()));
    let project = args.project.as_deref().map(|project| ("project", project));
    let filters: Vec<_> = state.into_iter().chain(project).collect();
    let jobs = client.newest_jobs(&filters, args.most).await.context("cannot list the jobs")?;
    if args.json {
        return output::json(&jobs);
    }
    if jobs.is_empty() {
        let none = if filters.is_empty() {
            "there are no jobs yet; `forelight submit` makes one"
        } else {
            "no jobs match"
        };
        return output::line(none);
    }
    output::print(&report(&jobs, Timestamp::now()))
}

fn report(jobs: &[Job], now: Timestamp) -> String {
    let mut table = Table::new(&[
        ("job", Align::Left),
        ("project", Align::Left),
        ("state", Align::Left),
        ("progress", Align::Left),
        ("frames", Align::Right),
        ("ready", Align::Right),
        ("deadline", Align::Right),
        ("", Align::Left),
        ("id", Align::Left),
    ]);
    let time = |at: Option<Timestamp>| at.map_or("-".into(), |at| clock(at, now));
    for job in jobs {
        let ready = if job.state == JobState::Done { job.finished_at } else { job.eta };
        let late = ready.zip(job.deadline).is_some_and(|(ready, deadline)| ready > deadline);
        let at_risk = job.promise.as_ref().is_some_and(|promise| !promise.kept && !job.state.is_final());
        table.row([
            job.name.clone(),
            job.project.clone(),
            if job.paused { format!("{}, paused", job.state) } else { job.state.to_string() },
            bar(job.progress, 12),
            format!("{}/{}", job.frames_done, job.frames_total),
            time(ready),
            time(job.deadline),
            if late || at_risk { "!".into() } else { String::new() },
            job.id.to_string(),
        ]);
    }
    table.render()
}
