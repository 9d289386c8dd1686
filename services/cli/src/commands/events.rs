//! `forelight events`: what happens on the farm, as it happens.

use super::cancel::find_any;
use crate::connection::{ConnectionOptions, connect};
use anyhow::{Context, Result};
use forelight_client::{Backoff, Client, ClientError, EventStream};
use forelight_protocol::words::by_name;
use forelight_protocol::{Event, EventId, EventKind, JobId, NodeId, Timestamp};
use forelight_terminal::failure::StoppedWatching;
use forelight_terminal::foreign_text::shown;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output;
use forelight_terminal::quantities::{clock, with_local_times};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::time::Duration;

/// After this time without an event, the stream is opened again, because a dead one may give no sign.
const QUIET: Duration = Duration::from_secs(60);

/// Show what happens on the farm from now on, or to a job from its beginning: a line for each event
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight events --data farm-data
  forelight events kitchen --data farm-data
  forelight events --only task_failed --only lease_expired --server http://farm:7878 --token-file me.token
  forelight events --json --after 48210 --data farm-data

The command goes on until you stop it, and through restarts of the service. With a job, it ends when the job is over. \
Nothing is shown of the progress of tasks, unless --only task_progress asks for it.")]
pub struct Args {
    /// Id of a job, or its name if only one job has it. Without it, all events are shown that your token may see
    #[arg(value_name = "JOB")]
    job: Option<String>,
    /// Show events of this kind alone, such as task_failed. May be repeated
    #[arg(long, value_name = "KIND", value_parser = kind)]
    only: Vec<EventKind>,
    /// Go on after this event, as `id` of --json names it
    #[arg(long, value_name = "ID")]
    after: Option<EventId>,
    /// Print each event as JSON, one a line
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

fn kind(text: &str) -> Result<EventKind, String> {
    by_name(&text.replace('-', "_"))
}

pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    let client = connect(&args.connection)?;
    let stopped = interrupt.token();
    let last = Cell::new(args.after);
    let shown = async {
        let job = match &args.job {
            Some(wanted) => Some(find_any(&client, wanted).await?),
            None => None,
        };
        show(&client, job, &args, &last).await
    };
    tokio::select! {
        shown = shown => shown,
        () = stopped.cancelled() => {
            let again = last.get().map_or(String::new(), |last| format!("; `--after {last}` goes on from here"));
            Err(StoppedWatching(format!("stopped{again}")).into())
        }
    }
}

/// Shows events until the job is over, through lost connections and restarts of the service.
async fn show(client: &Client, job: Option<JobId>, args: &Args, last: &Cell<Option<EventId>>) -> Result<()> {
    let mut lines = Lines { client, nodes: BTreeMap::new() };
    let mut failures = 0;
    loop {
        match open(client, job, last.get()).await {
            Ok(mut stream) => {
                failures = 0;
                while let Ok(Some(event)) = tokio::time::timeout(QUIET, stream.next()).await {
                    last.set(Some(event.id));
                    if !is_wanted(event.kind, &args.only) {
                        continue;
                    }
                    if args.json {
                        output::json_line(&event)?;
                    } else {
                        output::line(lines.of(&event).await)?;
                    }
                }
                // A stream of a job ends with it.
                if let Some(id) = job
                    && client.job(id).await.is_ok_and(|job| job.state.is_final())
                {
                    return Ok(());
                }
            }
            Err(error) => {
                failures += 1;
                let patience = Backoff { attempts: Some(30), ..Backoff::PATIENT };
                // What the service refuses stays refused.
                let wait = patience.jittered(failures, None).filter(|_| error.problem().is_none());
                let Some(wait) = wait else { return Err(error).context("cannot follow the events") };
                tokio::time::sleep(wait).await;
            }
        }
    }
}

async fn open(
    client: &Client,
    job: Option<JobId>,
    last: Option<EventId>,
) -> Result<EventStream, ClientError> {
    match job {
        Some(job) => client.events(job, last).await,
        None => client.farm_events(last).await,
    }
}

fn is_wanted(kind: EventKind, only: &[EventKind]) -> bool {
    if only.is_empty() { kind != EventKind::TaskProgress } else { only.contains(&kind) }
}

/// Events as lines.
struct Lines<'a> {
    client: &'a Client,
    /// Names of the nodes that are known.
    nodes: BTreeMap<NodeId, String>,
}

impl Lines<'_> {
    async fn of(&mut self, event: &Event) -> String {
        if let Some(node) = event.node_id.filter(|node| !self.nodes.contains_key(node))
            && let Ok(nodes) = self.client.nodes().await
        {
            self.nodes.extend(nodes.into_iter().map(|node| (node.id, node.name)));
            // One that was removed is asked for once.
            self.nodes.entry(node).or_insert_with(|| node.to_string());
        }
        let node = event.node_id.and_then(|node| self.nodes.get(&node));
        line(event, node.map(String::as_str), Timestamp::now())
    }
}

/// An event as `12:01:05  task_failed  kitchen: render of frame 3 on rack-1: exit code 3`.
fn line(event: &Event, node: Option<&str>, now: Timestamp) -> String {
    let task = event.task_kind.map(|kind| {
        let frame = event.frame.map_or(String::new(), |frame| format!(" of frame {frame}"));
        let part = event.part.map_or(String::new(), |part| format!(", part {part}"));
        let node = node.map_or(String::new(), |node| format!(" on {node}"));
        format!("{kind}{frame}{part}{node}")
    });
    let state = event.job_state.map(|state| state.to_string());
    let progress = event.progress.map(|progress| format!("{:.0} %", progress * 100.0));
    // Some events say the name of their job alone.
    let message = event.message.as_deref().filter(|message| event.job_name.as_deref() != Some(*message));
    let message = message.map(|message| with_local_times(message, now));
    let said: Vec<String> =
        event.job_name.clone().into_iter().chain(state).chain(task).chain(progress).chain(message).collect();
    let text = format!("{}  {:<16}  {}", clock(event.at, now), event.kind.name(), said.join(": "));
    shown(text.trim_end()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn event(more: serde_json::Value) -> Event {
        let mut event = json!({"id": 7, "at": "2026-03-01T18:00:00Z", "kind": "task_failed"});
        event.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        serde_json::from_value(event).unwrap()
    }

    #[test]
    fn a_line_says_what_happened_to_which_task_and_where() {
        let failed = event(json!({
            "job_name": "kitchen", "task_kind": "render", "frame": 3, "node_id": NodeId::new(), "message": "exit\u{1b}[2J code 3",
        }));
        let said = line(&failed, Some("rack-1"), failed.at);
        assert!(
            said.ends_with("  task_failed       kitchen: render of frame 3 on rack-1: exit\\u{1b}[2J code 3"),
            "{said}"
        );
        let state = event(json!({"kind": "job_state", "job_name": "kitchen", "job_state": "done"}));
        assert!(line(&state, None, state.at).ends_with("  job_state         kitchen: done"));
        let created = event(json!({"kind": "job_created", "job_name": "kitchen", "message": "kitchen"}));
        assert!(line(&created, None, created.at).ends_with("  job_created       kitchen"));
        let budget = event(json!({"kind": "budget", "project": "film", "message": "film: 80 % is spent"}));
        assert!(line(&budget, None, budget.at).ends_with("  budget            film: 80 % is spent"));
    }

    #[test]
    fn progress_is_shown_only_if_it_is_asked_for() {
        assert!(is_wanted(EventKind::TaskDone, &[]) && !is_wanted(EventKind::TaskProgress, &[]));
        let only = [kind("task_progress").unwrap(), kind("task-failed").unwrap()];
        assert!(is_wanted(EventKind::TaskProgress, &only) && !is_wanted(EventKind::TaskDone, &only));
        assert!(kind("task_exploded").is_err());
    }
}
