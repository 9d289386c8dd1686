//! `forelight farm`: the service and its workers, in one process on this machine.

use super::serve::{self, Executor, ServiceOptions, reachable};
use super::worker::{RendererOptions, equipment, measured, secrets};
use anyhow::Result;
use forelight_client::Client;
use forelight_protocol::words::counted;
use forelight_protocol::{Capabilities, Money, NodeRegistration};
use forelight_renderer_own::node_speed;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::PreviewBackend;
use forelight_terminal::output;
use forelight_terminal::quantities::parse_money;
use forelight_worker::{Agent, AgentError};
use std::io::IsTerminal as _;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// Run a whole farm on this machine: the service and its workers
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight farm --data farm-data --workers 2
  forelight farm --workers 4 --threads 2 --price 0.50 --listen 127.0.0.1:0
  forelight farm --executor slurm --data /shared/farm-data
  forelight submit kitchen/ --data farm-data --out images/

Each worker is a node of the farm with a name, a measured speed and a price. More workers join from other machines \
with `forelight worker`. Ctrl-C returns leased tasks and ends the farm. After a crash the next start continues where \
the farm was.")]
pub struct Args {
    #[command(flatten)]
    service: ServiceOptions,
    /// Number of workers in this process. With --executor slurm there are none
    #[arg(long, value_name = "COUNT", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=256))]
    workers: u16,
    /// Number of threads of each worker
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    /// Price of an hour of each worker, in the farm's currency, such as 0.50
    #[arg(long, value_name = "AMOUNT", default_value = "0", value_parser = parse_money)]
    price: i64,
    #[command(flatten)]
    renderers: RendererOptions,
    /// Device that renders ID previews
    #[arg(long, value_name = "WHO", default_value = "auto")]
    preview: PreviewBackend,
}
pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    // What follows takes a while, and makes folders.
    args.service.check()?;
    serve::check_address(&args.service)?;
    let folder = args.service.data.join("bundles");
    let (bundles, executor, capabilities) =
        equipment(&folder, args.preview, &args.renderers, secrets(&args.service.data))?;
    // Measured before the workers have other work.
    let calibration = measured(folder, capabilities.processor.clone()).await?;
    let speed = node_speed(&calibration);
    let capabilities = Capabilities { calibration: Some(calibration), ..capabilities };
    let running = serve::start(&args.service).await?;
    let client = Client::new(&reachable(&running.home_address()), Some(running.operator_token()))?;
    let stop = CancellationToken::new();
    let mut agents: JoinSet<Result<(), AgentError>> = JoinSet::new();
    // Slurm starts processes on its own nodes, and this machine may be one of them.
    let workers = if args.service.executor == Executor::Slurm { 0 } else { args.workers };
    for number in 1..=workers {
        let registration = NodeRegistration {
            name: format!("node-{number}"),
            speed,
            price_per_hour: Money(args.price),
            cores: u32::from(args.threads),
            capabilities: capabilities.clone(),
            schedule: None,
            worker: None,
        };
        let agent = Agent::new(client.clone(), bundles.clone(), executor.clone(), registration)?;
        let stop = stop.clone();
        agents.spawn(async move { agent.run(stop).await });
    }
    let threads = args.threads;
    output::line(running.greeting())?;
    // A log is read by others, and a link that signs in is not for them.
    output::line(if std::io::stdout().is_terminal() {
        format!("dashboard, signed in once within five minutes: {}", running.sign_in_link().await?)
    } else {
        format!("dashboard at {}/", running.public_address())
    })?;
    output::line(match workers {
        0 => "Slurm starts the workers; Ctrl-C ends the farm, and Slurm's jobs go on".to_owned(),
        _ => {
            let (workers, threads) = (counted(workers, "worker"), counted(threads, "thread"));
            format!("{workers} of {threads}, speed {speed:.2}; Ctrl-C ends the farm")
        }
    })?;
    let stopped = interrupt.token();
    // A worker ends by itself only if the service refuses it, which is an error here.
    let mut outcome = tokio::select! {
        () = stopped.cancelled() => Ok(()),
        Some(ended) = agents.join_next() => ended.map_err(anyhow::Error::from).and_then(|end| Ok(end?)),
    };
    stop.cancel();
    while let Some(ended) = agents.join_next().await {
        outcome = outcome.and(ended.map_err(anyhow::Error::from).and_then(|end| Ok(end?)));
    }
    running.shutdown().await;
    outcome
}
