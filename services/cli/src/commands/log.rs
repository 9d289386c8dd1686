//! `forelight log`: the logs of tasks, as their workers wrote them.

use super::cancel::find_any;
use crate::connection::ConnectionOptions;
use crate::connection::connect;
use crate::named;
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_protocol::{JobId, TaskId, TaskLog, TaskRow, Timestamp};
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign_text::shown;
use forelight_terminal::output;
use forelight_terminal::quantities::clock;

/// Show the log of a task, or of a job's frame: all attempts, oldest line first
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight log 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data
  forelight log 0192f0c1-7a3b-7c55-8f00-0123456789ab --json
  forelight log kitchen --frame 3 --data farm-data

The error of a failed job names the task, and so do events. While a worker does the task, the log grows with \
every renewal of the lease. A frame has several tasks if it was profiled, or is rendered in parts.")]
pub struct Args {
    /// Id of the task. With --frame, id of the job, or its name if only one job has it
    #[arg(value_name = "TASK|JOB")]
    wanted: String,
    /// Show the logs of all tasks of this frame of the job
    #[arg(long, value_name = "N")]
    frame: Option<u32>,
    /// Print the log as JSON to standard output; with --frame, a list of logs
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args) -> Result<()> {
    let Some(frame) = args.frame else {
        let task: TaskId = named::id(&args.wanted).map_err(|reason| {
            BadInput::new(format!("{}: {reason}", args.wanted))
                .hint("the logs of a job's frame are shown by `forelight log JOB --frame N`")
        })?;
        let log = read(&connect(&args.connection)?, task).await?;
        return if args.json { output::json(&log) } else { output::print(&report(&log, Timestamp::now())) };
    };
    let client = connect(&args.connection)?;
    let job = find_any(&client, &args.wanted).await?;
    let logs = of_frame(&client, job, frame).await?;
    if args.json {
        return output::json(&logs.into_iter().map(|(_, log)| log).collect::<Vec<_>>());
    }
    let now = Timestamp::now();
    let text = |(task, log): &(TaskRow, TaskLog)| format!("{}\n{}", heading(task), report(log, now));
    output::print(&logs.iter().map(text).collect::<Vec<_>>().join("\n"))
}

/// The tasks of a frame with their logs, oldest first.
async fn of_frame(client: &Client, job: JobId, frame: u32) -> Result<Vec<(TaskRow, TaskLog)>> {
    let tasks = client.tasks_of_frame(job, frame).await;
    let tasks = tasks.with_context(|| format!("cannot list the tasks of frame {frame} of job {job}"))?;
    if tasks.is_empty() {
        let reason = format!("--frame {frame}: job {job} has no task for this frame");
        return Err(BadInput::new(reason)
            .hint(format!("`forelight status {job}` says how far it is"))
            .into());
    }
    let mut logs = Vec::with_capacity(tasks.len());
    for task in tasks {
        let log = read(client, task.id).await?;
        logs.push((task, log));
    }
    Ok(logs)
}

async fn read(client: &Client, task: TaskId) -> Result<TaskLog> {
    client.task_log(task).await.with_context(|| format!("cannot read the log of task {task}"))
}

fn heading(task: &TaskRow) -> String {
    format!("{} {}", task.kind, task.id)
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
