//! `forelight bench workers`: one service with thousands of workers.
//!
//! Each simulated worker holds the lease of a frame, keeps one connection open, and renews its lease at the
//! given interval with progress. The workers start evenly spread over the interval. The service runs in its
//! own process on the same machine.

use super::filling::{LEASE, fill};
use super::pages::{Pages, PagesSeen};
use super::service::{ServiceProcess, temporary_folder};
use super::siege::{Besieged, Besiegers};
use crate::report::Report;
use crate::statistics::quantile;
use anyhow::{Result, anyhow, bail};
use forelight_client::{Backoff, Client, Token};
use forelight_protocol::{LeaseId, LeaseOrder, RenewRequest, Role, Timestamp};
use forelight_store::{Answered, DATABASE, Store};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::duration;
use forelight_terminal::output::Bars;
use rusqlite::{Connection, OpenFlags};
use serde::Serialize;
use std::path::PathBuf;
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::Instant;
use uuid::Uuid;

/// Measure a service with thousands of workers
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench workers
  forelight bench workers --workers 1000 --heartbeat 2s --time 30s --json
  forelight bench workers --workers 1000 --idle 2500 --slow 500 --costly 400 --trickled 2
  forelight bench workers --data farm-data --pages 200

Each worker has its own connection. Latency is measured by the worker, from the request to the complete \
answer.")]
pub struct Args {
    /// Number of workers
    #[arg(long, value_name = "COUNT", default_value_t = 5000, value_parser = clap::value_parser!(u32).range(1..=20_000))]
    workers: u32,
    /// Interval between heartbeats of a worker
    #[arg(long, value_name = "DURATION", default_value = "10s", value_parser = duration)]
    heartbeat: Duration,
    /// Duration of the measurement
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = duration)]
    time: Duration,
    #[command(flatten)]
    besiegers: Besiegers,
    /// Open dashboard pages, which follow all events and summaries, and ask for the dashboard every half minute
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=5000))]
    pages: u32,
    /// Folder for the database, on the disk to measure [default: a temporary folder]
    #[arg(long, value_name = "DIR", conflicts_with = "data")]
    folder: Option<PathBuf>,
    /// A farm that is there already: its tasks that are leased are renewed. Its service must not run. What
    /// happens to it is not undone
    #[arg(long, value_name = "DIR", conflicts_with = "workers")]
    data: Option<PathBuf>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Document {
    workers: u32,
    heartbeat_seconds: f64,
    seconds: f64,
    heartbeats: usize,
    heartbeats_per_second: f64,
    errors: usize,
    first_error: Option<String>,
    p50_ms: f64,
    p99_ms: f64,
    longest_ms: f64,
    server_peak_bytes: u64,
    /// Memory of the server some seconds after the end.
    server_bytes_after: u64,
    /// Mean CPU use of the server in cores.
    server_cores: f64,
    besiegers: Besiegers,
    besieged: Besieged,
    pages: u32,
    pages_seen: PagesSeen,
}

/// A lease that a worker holds.
#[derive(Clone, Copy)]
struct Held {
    id: LeaseId,
    fence: u64,
}

/// Measurements of one worker.
#[derive(Default)]
struct Seen {
    seconds: Vec<f64>,
    errors: Vec<String>,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let document = runtime.block_on(measure(args, interrupt))?;
    report(&document).printed(args.json, &document)
}

async fn measure(args: &Args, interrupt: &Interrupt) -> Result<Document> {
    let folder = temporary_folder(args.folder.as_deref())?;
    let bars = Bars::new(args.json);
    let (data, leases) = match &args.data {
        Some(data) => (data.clone(), held(data)?),
        None => {
            let data = folder.path().join("data");
            let leases = lease(&data, args.workers, &bars).await?;
            (data, leases)
        }
    };
    let workers = u32::try_from(leases.len())?;
    // One connection per worker, two per page. The service raises its own limit at start.
    forelight_terminal::open_files::allow(u64::from(workers + args.besiegers.all() + 2 * args.pages) + 256)?;
    let service = ServiceProcess::start(&data)?;
    let tokens = [service.token_of(Role::Viewer)?, service.token_of(Role::Submitter)?];
    let reader = Client::new(&service.address, Some(Token::new(&tokens[0])))?;
    let jobs = reader.newest_jobs(&[], 50).await?;
    let jobs: Vec<String> = jobs.iter().map(|job| job.id.to_string()).collect();
    let siege = args.besiegers.start(&service.address, [&tokens[0], &tokens[1]], &jobs)?;
    let pages = Pages::open(args.pages, &service.address, &tokens[0])?;
    let cpu = service.cpu_seconds()?;
    let start = Instant::now();
    let end = start + args.time;
    let mut set = JoinSet::new();
    for (number, lease) in (0u32..).zip(leases) {
        let client = Client::new(&service.address, Some(Token::new(&service.token)))?
            .with_backoff(Backoff { attempts: Some(1), ..Backoff::PATIENT });
        let first = start + args.heartbeat.mul_f64(f64::from(number) / f64::from(workers));
        let heartbeat = args.heartbeat;
        set.spawn(async move { worker(&client, lease, first, end, heartbeat).await });
    }
    let spinner = bars.spinner(format!("{workers} workers for {} s", args.time.as_secs()));
    let mut all = Seen::default();
    let stopped = interrupt.token();
    loop {
        let seen = tokio::select! {
            () = stopped.cancelled() => return Err(Interrupted.into()),
            seen = set.join_next() => seen,
        };
        let Some(seen) = seen else { break };
        let seen = seen.map_err(|error| anyhow!(error))?;
        all.seconds.extend(seen.seconds);
        all.errors.extend(seen.errors);
    }
    spinner.finish_and_clear();
    let (besieged, pages_seen) = (siege.end(), pages.end());
    let seconds = start.elapsed().as_secs_f64();
    let server_cores = (service.cpu_seconds()? - cpu) / seconds;
    tokio::time::sleep(AFTERWARDS).await;
    all.seconds.sort_by(f64::total_cmp);
    let millis = |share| 1e3 * quantile(&all.seconds, share);
    Ok(Document {
        workers,
        heartbeat_seconds: args.heartbeat.as_secs_f64(),
        seconds,
        heartbeats: all.seconds.len(),
        heartbeats_per_second: all.seconds.len() as f64 / seconds,
        errors: all.errors.len(),
        first_error: all.errors.into_iter().next(),
        p50_ms: millis(0.5),
        p99_ms: millis(0.99),
        longest_ms: millis(1.0),
        server_peak_bytes: service.status_bytes("VmHWM")?,
        server_bytes_after: service.status_bytes("VmRSS")?,
        server_cores,
        besiegers: args.besiegers.clone(),
        besieged,
        pages: args.pages,
        pages_seen,
    })
}

/// Time after the end until memory is looked at again.
const AFTERWARDS: Duration = Duration::from_secs(5);

/// Makes a farm whose nodes hold one lease each, before the service starts.
async fn lease(data: &std::path::Path, workers: u32, bars: &Bars) -> Result<Vec<Held>> {
    let bar = bars.bar("leases", u64::from(workers));
    let store = Store::open(data).await?;
    let nodes = fill(&store, workers, workers).await?;
    let mut leases = Vec::new();
    for node in nodes {
        // Long enough for slow machines. The service extends each lease when it starts.
        let claimed = store.claim(node.id, Duration::from_secs(3600), None, Timestamp::now()).await?;
        let Some(Answered::Fresh(lease)) = claimed else { bail!("the farm leased no frame") };
        leases.push(Held { id: lease.lease_id, fence: lease.fence });
        bar.inc(1);
    }
    bar.finish_and_clear();
    store.close().await;
    Ok(leases)
}

/// The active leases of a farm that is there already.
fn held(data: &std::path::Path) -> Result<Vec<Held>> {
    let path = data.join(DATABASE);
    let database = Connection::open_with_flags(&path, OpenFlags::SQLITE_OPEN_READ_WRITE)
        .map_err(|error| BadInput::new(format!("--data {}: {error}", path.display())))?;
    let mut active = database.prepare("SELECT id, fence FROM leases WHERE state = 'active' ORDER BY id")?;
    let rows = active.query_map([], |row| Ok((row.get::<_, Vec<u8>>(0)?, row.get::<_, i64>(1)?)))?;
    let mut leases = Vec::new();
    for row in rows {
        let (id, fence) = row?;
        leases.push(Held { id: LeaseId(Uuid::from_slice(&id)?), fence: u64::try_from(fence)? });
    }
    if leases.is_empty() {
        return Err(BadInput::new(format!("--data {}: no task is leased", data.display())).into());
    }
    Ok(leases)
}

async fn worker(client: &Client, lease: Held, first: Instant, end: Instant, heartbeat: Duration) -> Seen {
    /// Progress per heartbeat: a frame takes 200.
    const STEP: f64 = 0.005;
    let mut seen = Seen::default();
    let mut next = first;
    let mut progress: f64 = 0.0;
    while next < end {
        tokio::time::sleep_until(next).await;
        progress = (progress + STEP).min(1.0);
        let renewal = RenewRequest { fence: lease.fence, progress, ..RenewRequest::default() };
        let begun = Instant::now();
        match client.renew(lease.id, &renewal, LEASE).await {
            Ok(renewed) if renewed.order == LeaseOrder::Continue => {
                seen.seconds.push(begun.elapsed().as_secs_f64());
            }
            Ok(renewed) => seen.errors.push(format!("the order was {:?}", renewed.order)),
            Err(error) => seen.errors.push(error.to_string()),
        }
        // Keep the beat, however long the answer took.
        next += heartbeat;
    }
    seen
}

fn report(document: &Document) -> Report {
    let error = document.first_error.as_ref().map_or(String::new(), |error| format!(", the first: {error}"));
    let Besiegers { idle, slow, costly, trickled } = &document.besiegers;
    let siege = if document.besiegers.all() == 0 {
        String::new()
    } else {
        let answers: Vec<String> =
            document.besieged.answers.iter().map(|(status, count)| format!("{count} × {status}")).collect();
        format!(
            "beside {idle} idle and {slow} slow connections, {costly} clients of costly answers, {trickled} \
             trickled uploads\nconnections closed {}; costly answers {}\n",
            document.besieged.closed,
            forelight_terminal::output::list(&answers)
        )
    };
    let pages = pages_report(document.pages, &document.pages_seen);
    Report::default().text(format!(
        "{} workers, a heartbeat every {} s, for {:.0} s: {} heartbeats, {:.0} a second\n\
         latency {:.1} ms (median), {:.1} ms (p99), {:.1} ms (longest)\n\
         errors {}{error}\n\
         server {:.0} MB at its peak, {:.0} MB afterwards, {:.2} cores\n\
         {siege}{pages}",
        document.workers,
        document.heartbeat_seconds,
        document.seconds,
        document.heartbeats,
        document.heartbeats_per_second,
        document.p50_ms,
        document.p99_ms,
        document.longest_ms,
        document.errors,
        document.server_peak_bytes as f64 * 1e-6,
        document.server_bytes_after as f64 * 1e-6,
        document.server_cores
    ))
}

fn pages_report(pages: u32, seen: &PagesSeen) -> String {
    if pages == 0 {
        return String::new();
    }
    format!(
        "beside {pages} open pages\n\
         {} events arrived after {:.0} ms (median), {:.0} ms (p99), {:.0} ms (longest)\n\
         {} dashboards, {:.0} ms (median), {:.0} ms (p99); failures {}\n",
        seen.events,
        seen.event_p50_ms,
        seen.event_p99_ms,
        seen.event_longest_ms,
        seen.dashboards,
        seen.dashboard_p50_ms,
        seen.dashboard_p99_ms,
        seen.failures
    )
}
