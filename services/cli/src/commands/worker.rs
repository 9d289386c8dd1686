//! `forelight worker`: a worker process on this machine, for a service anywhere.

use super::calibrate;
use crate::connection::ConnectionOptions;
use crate::connection::{connect, read_token};
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_protocol::{
    Capabilities, JoinRequest, Money, NodeCalendar, NodeCalibration, NodeRegistration, ProblemKind, TaskId,
    TaskLimits,
};
use forelight_store::{token_hash, tokens};
use forelight_terminal::atomic_file::write_secret;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::preview_choice;
use forelight_terminal::options::{PreviewBackend, duration};
use forelight_terminal::output;
use forelight_terminal::quantities::{parse_bytes, parse_money};
use forelight_worker::{Agent, Ambient, Errand, Library, TaskRunner, capabilities, node_speed};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Work for a service: take tasks, render, report
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight worker --server http://farm:7878 --token-file rack-7.token --name rack-7
  forelight worker --data farm-data --name this-machine --threads 2 --price 0.80
  forelight worker --data farm-data --schedule 'Mon-Fri 20:00-08:00 Europe/Berlin'
  forelight worker --server http://farm:7878 --join-token-file rack-8.join --token-file rack-8.token --name rack-8
  forelight worker --server http://farm:7878 --token-file rack-9.token --name rack-9 --calibration rack-7.json

The first time, the machine is calibrated for some seconds (see `forelight calibrate`). Ctrl-C stops taking tasks and gives the one at hand \
back. A restart of the service is survived: results are offered until they are taken.

With --join-token-file the machine joins the farm: the one-time token is burnt, and the machine's own token, which it makes itself, is \
kept in --token-file. Started again with the same flags it finds that token and uses it.")]
pub struct Args {
    /// Name of this node, unique on the farm: whoever starts under it takes the node over [default: the host's name]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// What an hour of this node costs
    #[arg(long, value_name = "AMOUNT", default_value = "0", value_parser = parse_money)]
    price: i64,
    /// Folder for fetched bundles [default: forelight-bundles in the system's folder for temporary files]
    #[arg(long, value_name = "DIR")]
    bundles: Option<PathBuf>,
    /// Who makes ID previews
    #[arg(long, value_name = "WHO", default_value = "auto")]
    preview: PreviewBackend,
    /// Do this one task and end: for what starts processes for tasks, such as Slurm. Waits while another worker has it; ends at
    /// once, with exit code 0, if it is over
    #[arg(long, value_name = "ID")]
    task: Option<TaskId>,
    /// Most memory that this process may use while it does a task, such as 8GiB; beyond it the task is ended [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    task_memory: Option<u64>,
    /// Most time that a task may take; beyond it the task is ended [default: no limit]
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    task_time: Option<Duration>,
    /// How often the finished tiles of a frame are sent to the service, for whoever has the frame next should this process be killed; frames
    /// of up to a million pixels without an irradiance cache
    #[arg(long, value_name = "DURATION", default_value = "1m", value_parser = duration)]
    checkpoints: Duration,
    /// File with a one-time token, to join the farm with; the machine's own token is kept in --token-file
    #[arg(long, value_name = "FILE", requires = "token_file")]
    join_token_file: Option<PathBuf>,
    /// How fast a core of this machine is, as `forelight calibrate --out` says of one like it [default: measured at the first start, and
    /// kept with the bundles]
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// When this machine is awake, such as "Mon-Fri 20:00-08:00, Sat-Sun 00:00-00:00 Europe/Berlin"; it takes no task that might not be done by
    /// the end of a window, and asks for none outside. What is set by `forelight node --schedule` goes before it [default: always]
    #[arg(long, value_name = "WINDOWS")]
    schedule: Option<NodeCalendar>,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Runs the command.
pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    let name = args.name.map_or_else(host_name, Ok)?;
    let folder = args.bundles.unwrap_or_else(|| std::env::temp_dir().join("forelight-bundles"));
    let (library, capabilities) = library(&folder, args.preview)?;
    let calibration = match &args.calibration {
        Some(file) => calibrate::read(file)?.1,
        None => measured(folder, capabilities.processor.clone()).await?,
    };
    let cores = args.threads.map_or_else(cores, u32::from);
    let registration = NodeRegistration {
        name: name.clone(),
        speed: node_speed(&calibration),
        price_per_hour: Money(args.price),
        cores,
        capabilities: Capabilities { calibration: Some(calibration), ..capabilities },
        schedule: args.schedule,
        worker: None,
    };
    let client = match &args.join_token_file {
        Some(one_time) => join(one_time, &args.connection, &registration).await?,
        None => connect(&args.connection)?,
    };
    let limits = task_limits(args.task_memory, args.task_time);
    let executor = Arc::new(TaskRunner::new(library.clone()));
    let agent = Agent::new(client.clone(), library, executor, registration)?
        .with_limits(limits)
        .with_checkpoints(args.checkpoints);
    let address = client.address();
    let Some(task) = args.task else {
        output::line(format!("worker {name} with {cores} threads for {address}"))?;
        return Ok(agent.run(interrupt.token()).await?);
    };
    output::line(format!("task {task} on {name} with {cores} threads for {address}"))?;
    match agent.run_task(task, interrupt.token()).await? {
        Errand::Ended => output::line("ended; the service knows how"),
        Errand::Needless => output::line("needless: the task was over already"),
        Errand::Stopped => Err(Interrupted.into()),
    }
}

/// The bundles of a process, with the renderer that opens them, and what this machine has.
pub fn library(folder: &Path, preview: PreviewBackend) -> Result<(Arc<Library>, Capabilities)> {
    let ambient = Ambient::new(preview_choice(preview));
    let capabilities = capabilities(&ambient).context("cannot make previews as asked")?;
    let library = Library::new(folder, Box::new(ambient))
        .with_context(|| format!("cannot keep bundles in {}", folder.display()))?;
    Ok((Arc::new(library), capabilities))
}

/// Limits of tasks, from flags.
pub fn task_limits(memory: Option<u64>, time: Option<Duration>) -> TaskLimits {
    let millis = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX).max(1);
    TaskLimits { memory_bytes: memory, wall_ms: time.map(millis) }
}

/// A client with this machine's own token: the one in the token file or, if the service does not know that, a new one for which the
/// one-time token is burnt. The own token is on disk before the service hears of it: whatever dies in between, nothing is lost.
async fn join(one_time: &Path, connection: &ConnectionOptions, node: &NodeRegistration) -> Result<Client> {
    let file = connection.token_file.as_ref().context("there is no file for the machine's own token")?;
    if !file.exists() {
        write_secret(file, tokens::random().as_bytes())?;
    }
    let client = connect(connection)?;
    match client.nodes().await {
        Ok(_) => return Ok(client),
        Err(error) if error.is(ProblemKind::Unauthenticated) => {}
        Err(error) => return Err(error.into()),
    }
    let own = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let request = JoinRequest { node: node.clone(), token_hash: token_hash(own.trim()) };
    Client::new(&connection.server, Some(read_token(one_time)?))?
        .join(&request)
        .await
        .with_context(|| format!("cannot join the farm with the one-time token in {}", one_time.display()))?;
    Ok(client)
}

/// How fast one core of this machine is, as kept in a folder or measured on a thread of its own.
pub async fn measured(folder: PathBuf, processor: Option<String>) -> Result<NodeCalibration> {
    let measure = move || calibrate::kept(&folder, processor.as_deref());
    tokio::task::spawn_blocking(measure).await.context("cannot measure this machine's speed")
}

/// Cores of this machine.
fn cores() -> u32 {
    std::thread::available_parallelism().map_or(1, |cores| u32::try_from(cores.get()).unwrap_or(1))
}

fn host_name() -> Result<String> {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    match name.trim() {
        "" => Err(BadInput::new("--name: this machine has no name of its own; give one").into()),
        name => Ok(name.to_owned()),
    }
}
