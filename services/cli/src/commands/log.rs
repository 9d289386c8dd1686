//! `forelight log`: what the workers of a task had to say.

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use anyhow::{Context, Result};
use forelight_protocol::{TaskId, TaskLog, Timestamp};
use forelight_terminal::output;
use forelight_terminal::quantities::clock;

/// Show the log of a task: all attempts, oldest first
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight log 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data
  forelight log 0192f0c1-7a3b-7c55-8f00-0123456789ab --json

The error of a job that failed names the task; events do, too. While the task is being done, its log grows with every renewal of the \
lease.")]
pub struct Args {
    /// The task
    task: TaskId,
    /// Print it as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Runs the command.
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
        format!("{} {:>2} {:5} {}\n", clock(line.at, now), line.attempt, line.level, line.text)
    };
    match log.lines.as_slice() {
        [] => "its workers have said nothing\n".into(),
        lines => lines.iter().map(line).collect(),
    }
}
