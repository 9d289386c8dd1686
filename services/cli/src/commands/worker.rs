//! `forelight worker`: a worker process on this machine, for a service on any machine.

use super::calibrate;
use crate::connection::{ConnectionOptions, Credentials, connect, read_token};
use crate::named;
use anyhow::{Context, Result};
use etcetera::BaseStrategy as _;
use forelight_client::Client;
use forelight_denoise::{Denoiser, Trial};
use forelight_kept::Folder;
use forelight_preview::SharedPreviewer;
use forelight_protocol::words::counted;
use forelight_protocol::{
    Capabilities, JoinRequest, Money, NodeCalendar, NodeCalibration, NodeRegistration, ProblemKind, TaskId,
    TaskLimits,
};
use forelight_renderer::door::Renderer;
use forelight_renderer::process::Sandbox;
use forelight_renderer::{Execute, Renderers};
use forelight_renderer_own::{Denoising, OwnRenderer, TaskRunner, node_speed};
use forelight_store::{DATABASE, token_hash, tokens};
use forelight_terminal::atomic_file::write_secret;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::foreign::installed;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::{cores, preview_choice};
use forelight_terminal::options::{PreviewBackend, duration};
use forelight_terminal::output;
use forelight_terminal::quantities::{parse_bytes, parse_money};
use forelight_video::{Encoder, VideoTasks};
use forelight_worker::{Agent, Bundles, Errand, machine};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Run a worker: take tasks from a service, do them, report the results
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight worker --server http://farm:7878 --token-file rack-7.token --name rack-7
  forelight worker --server https://farm:7878 --ca-file studio-ca.pem --token-file rack-7.token --name rack-7
  forelight worker --data farm-data --name this-machine --threads 2 --price 0.80
  forelight worker --data farm-data --schedule 'Mon-Fri 20:00-08:00 Europe/Berlin'
  forelight worker --server http://farm:7878 --join-token-file rack-8.join --token-file rack-8.token --name rack-8
  forelight worker --server http://farm:7878 --token-file rack-9.token --name rack-9 --calibration rack-7.json

The first start calibrates the machine for some seconds (see `forelight calibrate`). Ctrl-C returns the current task \
to the service and ends the worker. The worker survives a restart of the service: it sends its results again until \
the service has them.

With --join-token-file the machine joins the farm. This uses up the one-time token. The machine creates its own \
token, keeps it in --token-file, and uses it when it starts again with the same flags.")]
pub struct Args {
    /// Unique name of this node. A worker takes over a node with the same name [default: the host's name]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Price of an hour of this node, in the farm's currency, such as 0.80
    #[arg(long, value_name = "AMOUNT", default_value = "0", value_parser = parse_money)]
    price: i64,
    /// Folder for downloaded bundles [default: forelight/bundles in the user's cache folder, ~/.cache]
    #[arg(long, value_name = "DIR")]
    bundles: Option<PathBuf>,
    /// Device that renders ID previews
    #[arg(long, value_name = "WHO", default_value = "auto")]
    preview: PreviewBackend,
    /// Do only this task, for schedulers such as Slurm. The worker waits while another worker has the task.
    /// The exit code is 0 if the task is done already
    #[arg(long, value_name = "ID", value_parser = named::id::<TaskId>)]
    task: Option<TaskId>,
    #[command(flatten)]
    renderers: RendererOptions,
    /// Memory limit of a task, such as 8GiB. A task that exceeds it is ended [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    task_memory: Option<u64>,
    /// Time limit of a task, such as 2h. A task that exceeds it is ended [default: no limit]
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    task_time: Option<Duration>,
    /// Time between checkpoints of a frame, from which another worker can continue. Only for frames of at
    /// most a million pixels without an irradiance cache
    #[arg(long, value_name = "DURATION", default_value = "1m", value_parser = duration)]
    checkpoints: Duration,
    /// File with a one-time token to join the farm with. The machine keeps its own token in --token-file
    #[arg(long, value_name = "FILE", requires = "token_file")]
    join_token_file: Option<PathBuf>,
    /// Calibration from `forelight calibrate --out` on a machine of the same kind [default: measured once and
    /// kept]
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Times at which this machine works, such as "Mon-Fri 20:00-08:00 Europe/Berlin". Its tasks end within a
    /// window. `forelight node --schedule` overrides it [default: always]
    #[arg(long, value_name = "WINDOWS")]
    schedule: Option<NodeCalendar>,
    #[command(flatten)]
    connection: ConnectionOptions,
}
pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    let name = args.name.map_or_else(host_name, Ok)?;
    let folder = args.bundles.map_or_else(cache_folder, Ok)?;
    let Credentials { token_file, data, .. } = &args.connection.credentials;
    let hidden = [token_file, &args.join_token_file].into_iter().flatten().cloned();
    let hidden = hidden.chain(data.iter().flat_map(|data| secrets(data))).collect();
    let (bundles, executor, capabilities) = equipment(&folder, args.preview, &args.renderers, hidden)?;
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
    let agent = Agent::new(client.clone(), bundles, executor, registration)?
        .with_limits(limits)
        .with_checkpoints(args.checkpoints);
    let (address, threads) = (client.address(), counted(cores, "thread"));
    let Some(task) = args.task else {
        output::line(format!("worker {name} with {threads} for {address}"))?;
        return Ok(agent.run(interrupt.token()).await?);
    };
    output::line(format!("task {task} on {name} with {threads} for {address}"))?;
    match agent.run_task(task, interrupt.token()).await? {
        Errand::Ended => output::line("the task ended; the service has its result, or its error"),
        Errand::Dropped => output::line("the service no longer wants this task's result; it was dropped"),
        Errand::Needless(why) => output::line(format!("nothing to do: {why}")),
        Errand::Stopped => Err(Interrupted.into()),
    }
}

/// Renderers besides our own.
#[derive(Debug, clap::Args)]
pub struct RendererOptions {
    /// File that describes a renderer which can only be started, NAME.command.toml. May be repeated. Blender
    /// and Radiance are found without one
    #[arg(long, value_name = "FILE")]
    command: Vec<PathBuf>,
    /// Run Blender, Radiance and other programs in namespaces of their own. They write only the folders of their
    /// tasks, and reach neither the network nor the farm's tokens and database. Needs bubblewrap
    #[arg(long)]
    sandbox: bool,
}

/// What no renderer needs of a farm's data folder.
pub fn secrets(data: &Path) -> Vec<PathBuf> {
    // SQLite keeps what was written last beside the database.
    let of_database = ["", "-wal", "-shm"].map(|end| format!("{DATABASE}{end}"));
    let others = ["tokens", "artifacts", "checkpoints"].map(str::to_owned);
    others.into_iter().chain(of_database).map(|name| data.join(name)).collect()
}

/// The bundle folder, the renderers, and this machine's capabilities, for a worker that starts. In a sandbox,
/// renderers do not read what is hidden.
pub fn equipment(
    folder: &Path,
    preview: PreviewBackend,
    options: &RendererOptions,
    hidden: Vec<PathBuf>,
) -> Result<(Arc<Bundles>, Arc<Renderers>, Capabilities)> {
    remove_remains();
    let bundles = Bundles::new(folder)
        .with_context(|| format!("cannot keep bundles in the folder {}", folder.display()))?;
    let mut renderer = OwnRenderer::new(preview_choice(preview));
    let scenes = folder.join("scenes");
    match Folder::new(&scenes) {
        Ok(scenes) => renderer = renderer.keeping(scenes),
        Err(error) => tracing::warn!(folder = %scenes.display(), %error, "loaded scenes cannot be kept"),
    }
    let adapter =
        renderer.adapter().context("cannot render previews with the device that --preview names")?;
    let sandbox = options.sandbox.then(|| Sandbox::new(hidden)).transpose()?.map(Arc::new);
    let encoder =
        Encoder::find().inspect_err(|reason| tracing::info!(%reason, "this worker makes no videos")).ok();
    let ffmpeg = encoder.as_ref().map(|encoder| encoder.version().to_owned());
    let video =
        encoder.map(|encoder| Box::new(VideoTasks::new(encoder, sandbox.clone())) as Box<dyn Execute>);
    let others = others(&options.command, renderer.previewer())?;
    let (denoiser, denoising) = denoising(sandbox.clone()).unzip();
    let own = TaskRunner::new(renderer).with_denoising(denoising);
    let renderers = Renderers::new(Arc::new(own), others, sandbox).with_video(video);
    let capabilities = Capabilities {
        version: Some(env!("CARGO_PKG_VERSION").to_owned()),
        renderers: [OwnRenderer::id()].into_iter().chain(renderers.ids()).collect(),
        ffmpeg,
        denoiser,
        gpu: adapter.as_ref().is_some_and(|adapter| adapter.is_hardware),
        vulkan_adapter: adapter.and_then(|adapter| Capabilities::name(&adapter.name)),
        ..machine()
    };
    Ok((Arc::new(bundles), Arc::new(renderers), capabilities))
}

/// Ends and removes what a killed worker left: it would take this one's processors, memory and disk.
fn remove_remains() {
    let number = forelight_renderer::process::end_orphans();
    if number > 0 {
        tracing::warn!(number, "processes that a killed worker's programs had left behind were ended");
    }
    let number = forelight_kept::remove_abandoned(&std::env::temp_dir());
    if number > 0 {
        tracing::info!(number, "temporary folders that killed processes had left behind were removed");
    }
}

/// What removes noise on this machine, by its name and version. Logs why nothing does.
fn denoising(sandbox: Option<Arc<Sandbox>>) -> Option<(String, Denoising)> {
    let tried = Denoiser::find().and_then(|denoiser| {
        let Trial { by, nanos_per_pixel } = denoiser.try_out(sandbox.as_deref())?;
        Ok((by, Denoising { denoiser, nanos_per_pixel, sandbox }))
    });
    tried.inspect_err(|reason| tracing::info!(%reason, "this worker leaves noise in images")).ok()
}

/// The renderers besides our own. Logs those that were found, and why others were not.
fn others(commands: &[PathBuf], previewer: Arc<SharedPreviewer>) -> Result<Vec<Box<dyn Renderer>>> {
    let found = installed(commands, previewer)?;
    found.renderers.iter().for_each(|renderer| tracing::info!(renderer = %renderer.id(), "found"));
    found.missing.iter().for_each(|reason| tracing::debug!(%reason, "a renderer is missing"));
    Ok(found.renderers)
}

pub fn task_limits(memory: Option<u64>, time: Option<Duration>) -> TaskLimits {
    let millis = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX).max(1);
    TaskLimits { memory_bytes: memory, wall_ms: time.map(millis) }
}

/// A client with this machine's own token: the one in the token file if the service knows it, else a new one,
/// which uses up the one-time token. The new one is on disk before it is sent, so that a crash loses nothing.
async fn join(one_time: &Path, connection: &ConnectionOptions, node: &NodeRegistration) -> Result<Client> {
    let file = connection
        .credentials
        .token_file
        .as_ref()
        .context("--join-token-file needs --token-file for the machine's own token")?;
    if !file.exists() {
        write_secret(file, tokens::random().as_bytes())?;
    }
    let client = connect(connection)?;
    match client.nodes().await {
        Ok(_) => return Ok(client),
        Err(error) if error.is(ProblemKind::Unauthenticated) => {}
        Err(error) => return Err(error).context("cannot join the farm"),
    }
    let own = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let request = JoinRequest { node: node.clone(), token_hash: token_hash(own.trim()) };
    connection
        .server
        .client(read_token(one_time)?)?
        .join(&request)
        .await
        .with_context(|| format!("cannot join the farm with the one-time token in {}", one_time.display()))?;
    Ok(client)
}

/// This machine's calibration, read from `folder` or measured on a separate thread.
pub async fn measured(folder: PathBuf, processor: Option<String>) -> Result<NodeCalibration> {
    let measure = move || calibrate::kept(&folder, processor.as_deref());
    tokio::task::spawn_blocking(measure).await.context("cannot measure this machine's speed")
}

/// The folder for bundles in the user's own cache folder, which no other user can write to.
fn cache_folder() -> Result<PathBuf> {
    let user = etcetera::choose_base_strategy();
    let user =
        user.map_err(|error| BadInput::new(format!("--bundles: {error}; give a folder for bundles")))?;
    Ok(user.cache_dir().join("forelight/bundles"))
}

fn host_name() -> Result<String> {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    match name.trim() {
        "" => Err(BadInput::new("--name: this machine has no host name; give the node a name").into()),
        name => Ok(name.to_owned()),
    }
}
