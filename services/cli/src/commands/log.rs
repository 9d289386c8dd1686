//! `forelight log`: the log of a task, as its workers wrote it.

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use anyhow::{Context, Result};
use forelight_protocol::{TaskId, TaskLog, Timestamp};
use forelight_terminal::foreign_text::shown;
use forelight_terminal::output;
use forelight_terminal::quantities::clock;

/// Show the log of a task: all attempts, oldest line first
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight log 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data
  forelight log 0192f0c1-7a3b-7c55-8f00-0123456789ab --json

The error of a failed job names the task, and so do events. While a worker does the task, the log grows with \
every renewal of the lease.")]
pub struct Args {
    /// Id of the task
    task: TaskId,
    /// Print the log as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}
pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let log = client
        .task_log(args.task)
        .await
        .with_context(|| format!("cannot read the log of task {}", args.task))?;
    if args.json { output::json(&log) } else { output::print(&report(&log, Timestamp::now())) }
}

fn report(log: &TaskLog, now: Timestamp) -> String {
    let line = |line: &forelight_protocol::TaskLogLine| {
        format!("{} {:>2} {:5} {}\n", clock(line.at, now), line.attempt, line.level, shown(&line.text))
    };
    match log.lines.as_slice() {
        [] => "the log is empty\n".into(),
        lines => lines.iter().map(line).collect(),
    }
}
