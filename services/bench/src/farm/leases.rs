//! `forelight bench leases`: how many lease calls a second the service answers, beside what the same transactions take without a
//! service.
//!
//! Both sides do the same: a frame is claimed, its lease renewed once with progress, its result committed; every call is a
//! transaction that is flushed to disk before it is answered. *Bare* is SQL written by hand on a database file of its own (`bare`), with as many threads as do
//! best: no HTTP, no tokens, no JSON on the wire, no store. *HTTP* is the service in a process of its own, and in this process
//! as many workers at a time as asked for, with the client that real workers have. The two take turns, so that what else the
//! machine does meets both; medians of the rounds are compared.

use super::bare::Bare;
use super::filling::{LEASE, fill, name_of, registration, rendered};
use super::service::{ServiceProcess, temporary_folder};
use crate::report::Report;
use crate::statistics::{quantile, sorted, upper_median};
use anyhow::{Context, Result, anyhow, bail};
use forelight_client::{Client, Token};
use forelight_protocol::{ClaimRequest, Node, NodeId, RenewRequest, ResultRequest, TaskSpec};
use forelight_store::{DATABASE, Store};
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::JoinSet;
use uuid::Uuid;

/// Measure lease calls per second, over HTTP and without
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench leases
  forelight bench leases --workers 32 --rounds 9 --seconds 3 --json

A call is a claim, a renewal or a completion; each is on disk before it is answered. Bare is the same \
transactions as SQL written by hand, without service and HTTP, by as many threads as do best.")]
pub struct Args {
    /// Workers that call at the same time
    #[arg(long, value_name = "COUNT", default_value_t = 16, value_parser = clap::value_parser!(u16).range(1..=1000))]
    workers: u16,
    /// Rounds of each side, which take turns
    #[arg(long, value_name = "COUNT", default_value_t = 7, value_parser = clap::value_parser!(u16).range(1..=100))]
    rounds: u16,
    /// Seconds of each side in a round
    #[arg(long, value_name = "SECONDS", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=60))]
    seconds: u16,
    /// Folder for the databases: on the disk that is to be measured [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
}

/// What was measured.
#[derive(Debug, Serialize)]
struct Document {
    workers: u16,
    /// Threads that do best without the service.
    bare_threads: u32,
    /// Calls a second, by round.
    bare: Vec<f64>,
    http: Vec<f64>,
    bare_median: f64,
    http_median: f64,
    /// Median of HTTP over median of bare.
    ratio: f64,
    /// Of a call over HTTP, in milliseconds.
    latency_p50_ms: f64,
    latency_p99_ms: f64,
}

/// Frames that a side can at most get through in a second, with room to spare.
const FRAMES_A_SECOND: u32 = 4000;

/// Runs the command.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let document = runtime.block_on(measure(args, interrupt))?;
    report(&document).printed(args.json, &document)
}

/// A new farm in this folder.
async fn prepare(data: &Path, frames: u32, workers: u16) -> Result<Vec<Node>> {
    let store = Store::open(data).await?;
    let nodes = fill(&store, frames, u32::from(workers)).await?;
    store.close().await;
    Ok(nodes)
}

/// Something that takes its thread for a while.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| anyhow!(error))?
}

async fn measure(args: &Args, interrupt: &Interrupt) -> Result<Document> {
    let folder = temporary_folder(args.folder.as_deref())?;
    let bars = Bars::new(args.json);
    let frames =
        FRAMES_A_SECOND.saturating_mul(u32::from(args.rounds + 3) * u32::from(args.seconds)).min(80_000);
    let spinner = bars.spinner(format!("two farms of {frames} frames each"));
    let bare_data = folder.path().join("bare");
    let nodes = prepare(&bare_data, frames, args.workers).await?;
    let node = nodes.first().context("there are no workers")?.id;
    let mut bare_side = Bare::new(&bare_data.join(DATABASE), node)?;
    let data = folder.path().join("http");
    prepare(&data, frames, args.workers).await?;
    let service = ServiceProcess::start(&data)?;
    spinner.finish_and_clear();
    let mut workers = Vec::new();
    for number in 0..u32::from(args.workers) {
        let client = Client::new(&service.address, Some(Token::new(&service.token)))?;
        let node = client.register(&registration(&name_of(number)), Uuid::now_v7()).await?;
        workers.push((client, node.id));
    }
    let (mut bare, mut http, mut latencies) = (Vec::new(), Vec::new(), Vec::new());
    let time = Duration::from_secs(u64::from(args.seconds));
    bare_side = blocking(move || {
        bare_side.try_threads(time)?;
        Ok(bare_side)
    })
    .await?;
    let bare_side = Arc::new(bare_side);
    let bar = bars.bar("rounds", u64::from(args.rounds));
    for _ in 0..args.rounds {
        if interrupt.is_set() {
            return Err(Interrupted.into());
        }
        let side = bare_side.clone();
        bare.push(blocking(move || side.best_round(time)).await?);
        http.push(http_round(&workers, time, &mut latencies).await?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let median = |rates: &[f64]| upper_median(&sorted(rates.to_vec())).unwrap_or(0.0);
    let latencies = sorted(latencies);
    let (bare_median, http_median) = (median(&bare), median(&http));
    Ok(Document {
        workers: args.workers,
        bare_threads: bare_side.threads,
        bare,
        http,
        bare_median,
        http_median,
        ratio: http_median / bare_median,
        latency_p50_ms: 1e3 * quantile(&latencies, 0.5),
        latency_p99_ms: 1e3 * quantile(&latencies, 0.99),
    })
}

/// Calls a second of the service, all workers together; adds the seconds that each call took.
async fn http_round(workers: &[(Client, NodeId)], time: Duration, latencies: &mut Vec<f64>) -> Result<f64> {
    let start = Instant::now();
    let mut set = JoinSet::new();
    for (client, node) in workers {
        let (client, node) = (client.clone(), *node);
        set.spawn(async move {
            let mut took = Vec::new();
            while start.elapsed() < time {
                frame(&client, node, &mut took).await?;
            }
            Ok::<_, anyhow::Error>(took)
        });
    }
    let before = latencies.len();
    while let Some(worked) = set.join_next().await {
        latencies.extend(worked.map_err(|error| anyhow!(error))??);
    }
    Ok((latencies.len() - before) as f64 / start.elapsed().as_secs_f64())
}

/// One frame of one worker: three calls.
async fn frame(client: &Client, node: NodeId, took: &mut Vec<f64>) -> Result<()> {
    let mut last = Instant::now();
    let mut lap = |took: &mut Vec<f64>| {
        took.push(last.elapsed().as_secs_f64());
        last = Instant::now();
    };
    let claim = ClaimRequest { node_id: node, wait_ms: 0, task_id: None, worker: None };
    let lease = client.claim(&claim, Uuid::now_v7()).await.context("claim")?.lease();
    let lease = lease.context("there are no frames left: fewer rounds, please")?;
    lap(took);
    let renewal = RenewRequest { fence: lease.fence, progress: 0.5, ..RenewRequest::default() };
    client.renew(lease.lease_id, &renewal, LEASE).await.context("renewal")?;
    lap(took);
    let result = Some(result_of(&lease.spec)?);
    let end = ResultRequest { fence: lease.fence, result, ..ResultRequest::default() };
    client.report(lease.lease_id, &end).await.context("completion")?;
    lap(took);
    Ok(())
}

fn result_of(spec: &TaskSpec) -> Result<forelight_protocol::TaskResult> {
    match spec {
        TaskSpec::Render(spec) => Ok(rendered(spec.frame, spec.settings.spp)),
        other => bail!("a {} was handed out", other.kind()),
    }
}

fn report(document: &Document) -> Report {
    let mut table = Table::new(&[
        ("round", Align::Right),
        ("bare calls/s", Align::Right),
        ("HTTP calls/s", Align::Right),
        ("ratio", Align::Right),
    ]);
    let share = |ratio: f64| format!("{:.0} %", 100.0 * ratio);
    for (round, (bare, http)) in document.bare.iter().zip(&document.http).enumerate() {
        table.row([format!("{}", round + 1), format!("{bare:.0}"), format!("{http:.0}"), share(http / bare)]);
    }
    table.footer();
    table.row([
        "median".into(),
        format!("{:.0}", document.bare_median),
        format!("{:.0}", document.http_median),
        share(document.ratio),
    ]);
    let text = format!(
        "{} workers, {} threads without the service; a call over HTTP took {:.1} ms (median), {:.1} ms (p99)\n",
        document.workers, document.bare_threads, document.latency_p50_ms, document.latency_p99_ms
    );
    Report::default().table(table).text(text)
}
