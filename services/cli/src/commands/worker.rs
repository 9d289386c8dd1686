//! `forelight worker`: a worker process on this machine, for a service anywhere.

use crate::connection::connect;
use crate::failure::{BadInput, Interrupted};
use crate::interrupt::Interrupt;
use crate::local::preview_choice;
use crate::options::{ConnectionOptions, PreviewBackend};
use crate::output;
use crate::quantities::parse_money;
use anyhow::{Context, Result};
use forelight_protocol::{Money, NodeRegistration, TaskId};
use forelight_worker::{Agent, Ambient, Errand, Library, TaskRunner, node_speed};
use std::path::PathBuf;
use std::sync::Arc;

/// Work for a service: take tasks, render, report
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight worker --server http://farm:7878 --token-file rack-7.token --name rack-7
  forelight worker --data farm-data --name this-machine --threads 2 --price 0.80

The machine's speed is measured at the start (a third of a second). Ctrl-C stops taking tasks and gives the one at hand \
back. A restart of the service is survived: results are offered until they are taken.")]
pub struct Args {
    /// Name of this node, unique on the farm [default: the host's name]
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
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Runs the command.
pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    let client = connect(&args.connection)?;
    let name = args.name.map_or_else(host_name, Ok)?;
    let folder = args.bundles.unwrap_or_else(|| std::env::temp_dir().join("forelight-bundles"));
    let library = library(&folder, args.preview)?;
    let cores = args.threads.map_or_else(cores, u32::from);
    let registration = NodeRegistration {
        name: name.clone(),
        speed: measured_speed().await?,
        price_per_hour: Money(args.price),
        cores,
    };
    let executor = Arc::new(TaskRunner::new(library.clone()));
    let agent = Agent::new(client.clone(), library, executor, registration)?;
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

/// The bundles of a process, and the renderer that opens them.
pub fn library(folder: &std::path::Path, preview: PreviewBackend) -> Result<Arc<Library>> {
    let ambient = Ambient::new(preview_choice(preview));
    ambient.ready().context("cannot make previews as asked")?;
    let library = Library::new(folder, Box::new(ambient))
        .with_context(|| format!("cannot keep bundles in {}", folder.display()))?;
    Ok(Arc::new(library))
}

/// The speed of one core, measured on a thread of its own.
pub async fn measured_speed() -> Result<f64> {
    tokio::task::spawn_blocking(node_speed).await.context("cannot measure this machine's speed")
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
