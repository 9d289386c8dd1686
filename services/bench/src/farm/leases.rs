//! `forelight bench leases`: lease calls per second over HTTP, and of the same transactions without the
//! service.
//!
//! Both sides claim a frame, renew its lease once with progress, and commit its result. Every call is a
//! transaction that is flushed to disk before it returns. *Bare* is hand-written SQL on a separate database
//! (`bare`), with the best number of threads and no HTTP, tokens, JSON or store. *HTTP* is the service in its
//! own process, with the real client for each worker in this one. The sides alternate, so other load on the
//! machine affects both. Medians of the rounds are compared.

use super::bare::Bare;
use super::filling::{Images, LEASE, fill, name_of, registration, rendered};
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

A call is a claim, a renewal or a completion. Each is flushed to disk before its answer. Bare means the \
same transactions as hand-written SQL, without service and HTTP, with the best number of threads.")]
pub struct Args {
    /// Concurrent workers
    #[arg(long, value_name = "COUNT", default_value_t = 16, value_parser = clap::value_parser!(u16).range(1..=1000))]
    workers: u16,
    /// Rounds of each side; the sides alternate
    #[arg(long, value_name = "COUNT", default_value_t = 7, value_parser = clap::value_parser!(u16).range(1..=100))]
    rounds: u16,
    /// Seconds of each side in a round
    #[arg(long, value_name = "SECONDS", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=60))]
    seconds: u16,
    /// Folder for the databases, on the disk to measure [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Document {
    workers: u16,
    /// Best number of threads without the service.
    bare_threads: u32,
    /// Calls per second, by round.
    bare: Vec<f64>,
    http: Vec<f64>,
    bare_median: f64,
    http_median: f64,
    /// Median of HTTP over median of bare.
    ratio: f64,
    /// Latency of calls over HTTP, in milliseconds.
    latency_p50_ms: f64,
    latency_p99_ms: f64,
}

/// Generous upper bound of frames per second on a side.
const FRAMES_A_SECOND: u32 = 4000;

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let document = runtime.block_on(measure(args, interrupt))?;
    report(&document).printed(args.json, &document)
}

async fn prepare(data: &Path, frames: u32, workers: u16) -> Result<Vec<Node>> {
    let store = Store::open(data).await?;
    let nodes = fill(&store, frames, u32::from(workers)).await?;
    store.close().await;
    Ok(nodes)
}

/// Runs blocking work on a thread of its own.
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
    let node = nodes.first().context("no workers")?.id;
    let mut bare_side = Bare::new(&bare_data.join(DATABASE), node)?;
    let data = folder.path().join("http");
    prepare(&data, frames, args.workers).await?;
    let service = ServiceProcess::start(&data)?;
    spinner.finish_and_clear();
    let images = Images::new()?;
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
        http.push(http_round(&workers, images, time, &mut latencies).await?);
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

/// Calls per second of all workers together. Adds the seconds of each call to `latencies`.
async fn http_round(
    workers: &[(Client, NodeId)],
    images: Images,
    time: Duration,
    latencies: &mut Vec<f64>,
) -> Result<f64> {
    let start = Instant::now();
    let mut set = JoinSet::new();
    for (client, node) in workers {
        let (client, node) = (client.clone(), *node);
        set.spawn(async move {
            let mut took = Vec::new();
            while start.elapsed() < time {
                frame(&client, node, images, &mut took).await?;
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
async fn frame(client: &Client, node: NodeId, images: Images, took: &mut Vec<f64>) -> Result<()> {
    let mut last = Instant::now();
    let mut lap = |took: &mut Vec<f64>| {
        took.push(last.elapsed().as_secs_f64());
        last = Instant::now();
    };
    let claim = ClaimRequest { node_id: node, wait_ms: 0, task_id: None, worker: None };
    let lease = client.claim(&claim, Uuid::now_v7()).await.context("claim")?.lease();
    let lease = lease.context("no frames left: lower --rounds")?;
    lap(took);
    let renewal = RenewRequest { fence: lease.fence, progress: 0.5, ..RenewRequest::default() };
    client.renew(lease.lease_id, &renewal, LEASE).await.context("renewal")?;
    lap(took);
    let result = Some(result_of(&lease.spec, images)?);
    let end = ResultRequest { fence: lease.fence, result, ..ResultRequest::default() };
    client.report(lease.lease_id, &end).await.context("completion")?;
    lap(took);
    Ok(())
}

fn result_of(spec: &TaskSpec, images: Images) -> Result<forelight_protocol::TaskResult> {
    match spec {
        TaskSpec::Render(spec) => Ok(rendered(images, spec.frame, spec.settings.samples().unwrap_or(1))),
        other => bail!("the service leased a {} task instead of a frame", other.kind()),
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
