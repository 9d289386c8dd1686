//! How Slurm is used, for `forelight serve` and `forelight farm`.

use anyhow::{Context, Result};
use forelight_engine::slurm::{Options, Submitting};
use forelight_protocol::Money;
use forelight_terminal::failure::BadInput;
use forelight_terminal::options::{PreviewBackend, duration};
use forelight_terminal::quantities::parse_money;
use std::path::{Path, PathBuf, absolute};
use std::time::Duration;

/// How Slurm is used, with --executor slurm.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Slurm (with --executor slurm)")]
pub struct SlurmOptions {
    /// Partition whose nodes are used [default: Slurm's default one]
    #[arg(long, value_name = "NAME")]
    pub slurm_partition: Option<String>,
    /// Account that jobs are charged to [default: the user's]
    #[arg(long, value_name = "NAME")]
    pub slurm_account: Option<String>,
    /// Address at which nodes reach this service [default: the one that it listens on]
    #[arg(long, value_name = "URL")]
    pub slurm_server: Option<String>,
    /// The forelight program on the nodes [default: this one, at its path here]
    #[arg(long, value_name = "FILE")]
    pub slurm_program: Option<PathBuf>,
    /// File on the nodes that holds a worker's token [default: the one in --data, which is on shared storage then]
    #[arg(long, value_name = "FILE")]
    pub slurm_token_file: Option<PathBuf>,
    /// Folder on the nodes for fetched bundles [default: as for `forelight worker`]
    #[arg(long, value_name = "DIR")]
    pub slurm_bundles: Option<PathBuf>,
    /// Folder for what the processes say, on shared storage [default: slurm in --data]
    #[arg(long, value_name = "DIR")]
    pub slurm_logs: Option<PathBuf>,
    /// Who makes ID previews on the nodes
    #[arg(long, value_name = "WHO", default_value = "auto")]
    pub slurm_preview: PreviewBackend,
    /// What an hour of a node costs
    #[arg(long, value_name = "AMOUNT", default_value = "0", value_parser = parse_money)]
    pub slurm_price: i64,
    /// Time limit of previews and profiles. Of frames it is four times the 95 % quantile of their forecast on the slowest node, and
    /// two minutes; twice as much each time that a frame ran out of it
    #[arg(long, value_name = "DURATION", default_value = "1h", value_parser = duration)]
    pub slurm_quote_limit: Duration,
    /// Whether the booked nodes of jobs with a deadline are reserved: if Slurm lets this user, or never
    #[arg(long, value_name = "WHEN", default_value = "auto", value_parser = ["auto", "never"])]
    pub slurm_reservations: String,
    /// Pause between two looks at Slurm
    #[arg(long, value_name = "DURATION", default_value = "5s", value_parser = pause)]
    pub slurm_poll: Duration,
}

impl SlurmOptions {
    /// The same for the engine of a service at this address.
    pub fn engine(&self, address: &str, logs: &Path, token: &Path) -> Result<Options> {
        let server = match &self.slurm_server {
            Some(server) => server.clone(),
            None if address.contains("//0.0.0.0:") || address.contains("//[::]:") => {
                return Err(BadInput::new(
                    "--slurm-server: nodes need an address at which they reach this service",
                )
                .hint("the service listens on all of its addresses; name one of them, as in http://farm:7878")
                .into());
            }
            None => address.to_owned(),
        };
        let program = match &self.slurm_program {
            Some(program) => program.clone(),
            None => {
                std::env::current_exe().context("cannot find this program; name it by --slurm-program")?
            }
        };
        // Processes on the nodes start in another folder than this one.
        let there =
            |path: &Path| absolute(path).with_context(|| format!("cannot say where {} is", path.display()));
        let reserve = self.slurm_reservations != "never";
        let submitting = Submitting {
            partition: self.slurm_partition.clone(),
            account: self.slurm_account.clone(),
            program: there(&program)?,
            server,
            token_file: there(self.slurm_token_file.as_deref().unwrap_or(token))?,
            bundles: self.slurm_bundles.as_deref().map(there).transpose()?,
            preview: match self.slurm_preview {
                PreviewBackend::Auto => "auto",
                PreviewBackend::Gpu => "gpu",
                PreviewBackend::Cpu => "cpu",
            },
            price_per_hour: Money(self.slurm_price),
            logs: there(self.slurm_logs.as_deref().unwrap_or(logs))?,
        };
        Ok(Options {
            submitting,
            quote_minutes: u32::try_from(self.slurm_quote_limit.as_secs().div_ceil(60)).unwrap_or(u32::MAX),
            reserve_for: reserve.then(user),
            poll: self.slurm_poll,
        })
    }
}

/// Whose reservations they are: Slurm takes a user's number for a name.
fn user() -> String {
    rustix::process::getuid().as_raw().to_string()
}

/// A pause of at least a tenth of a second: Slurm's controller has others to serve.
fn pause(text: &str) -> Result<Duration, String> {
    let pause = duration(text)?;
    if pause < Duration::from_millis(100) { Err("must be at least 0.1s".to_owned()) } else { Ok(pause) }
}
