//! Options of Slurm, for `forelight serve` and `forelight farm`.

use anyhow::{Context, Result};
use forelight_engine::slurm::{Options, Submitting};
use forelight_protocol::Money;
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::refuse_because;
use forelight_terminal::options::{PreviewBackend, duration};
use forelight_terminal::quantities::parse_money;
use std::path::{Path, PathBuf, absolute};
use std::time::Duration;

/// Defaults, which `forelight serve --help` shows too.
const QUOTE_LIMIT: Duration = Duration::from_secs(3600);
const POLL: Duration = Duration::from_secs(5);

#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Slurm (with --executor slurm)")]
pub struct SlurmOptions {
    /// Partition whose nodes to use [default: Slurm's default partition]
    #[arg(long, value_name = "NAME")]
    pub slurm_partition: Option<String>,
    /// Account to charge jobs to [default: the user's default account]
    #[arg(long, value_name = "NAME")]
    pub slurm_account: Option<String>,
    /// Address at which nodes reach this service, such as http://farm:7878 [default: its own address]
    #[arg(long, value_name = "URL")]
    pub slurm_server: Option<String>,
    /// Path of the forelight program on the nodes [default: the path of this program]
    #[arg(long, value_name = "FILE")]
    pub slurm_program: Option<PathBuf>,
    /// File on the nodes with a worker's token [default: the file in --data, which must be on shared storage]
    #[arg(long, value_name = "FILE")]
    pub slurm_token_file: Option<PathBuf>,
    /// Folder on the nodes for fetched bundles [default: as for `forelight worker`]
    #[arg(long, value_name = "DIR")]
    pub slurm_bundles: Option<PathBuf>,
    /// Folder on shared storage for the logs of the processes [default: slurm in --data]
    #[arg(long, value_name = "DIR")]
    pub slurm_logs: Option<PathBuf>,
    /// Device that renders ID previews on the nodes
    #[arg(long, value_name = "WHO", default_value = "auto")]
    pub slurm_preview: PreviewBackend,
    /// Price of an hour of a node, in the farm's currency, such as 0.40
    #[arg(long, value_name = "AMOUNT", default_value = "0", value_parser = parse_money)]
    pub slurm_price: i64,
    /// Option for `forelight worker` on the nodes, such as --ca-file=/shared/farm.pem; may be given several times
    #[arg(long, value_name = "OPTION", allow_hyphen_values = true)]
    pub slurm_worker_option: Vec<String>,
    /// Time limit of previews and profiles, such as 1h. A frame's limit is two minutes plus four times the
    /// P95 of its forecast on the slowest node. The limit doubles each time that the frame exceeds it
    #[arg(long, value_name = "DURATION", default_value = "1h", value_parser = duration)]
    pub slurm_quote_limit: Duration,
    /// Reserve the booked nodes of jobs with a deadline: if Slurm permits it (auto), or never
    #[arg(long, value_name = "WHEN", default_value = "auto", value_parser = ["auto", "never"])]
    pub slurm_reservations: String,
    /// Time between two queries of Slurm's state, at least 0.1s
    #[arg(long, value_name = "DURATION", default_value = "5s", value_parser = pause)]
    pub slurm_poll: Duration,
}

impl SlurmOptions {
    /// Refuses options of Slurm where something else starts the workers.
    pub fn refuse(&self) -> Result<()> {
        let flags = [
            ("--slurm-partition", self.slurm_partition.is_some()),
            ("--slurm-account", self.slurm_account.is_some()),
            ("--slurm-server", self.slurm_server.is_some()),
            ("--slurm-program", self.slurm_program.is_some()),
            ("--slurm-token-file", self.slurm_token_file.is_some()),
            ("--slurm-bundles", self.slurm_bundles.is_some()),
            ("--slurm-logs", self.slurm_logs.is_some()),
            ("--slurm-preview", self.slurm_preview != PreviewBackend::Auto),
            ("--slurm-price", self.slurm_price != 0),
            ("--slurm-worker-option", !self.slurm_worker_option.is_empty()),
            ("--slurm-quote-limit", self.slurm_quote_limit != QUOTE_LIMIT),
            ("--slurm-reservations", self.slurm_reservations != "auto"),
            ("--slurm-poll", self.slurm_poll != POLL),
        ];
        refuse_because(&flags, "Slurm does not start the workers", "add --executor slurm, or leave it out")
    }

    pub fn engine(&self, address: &str, logs: &Path, token: &Path) -> Result<Options> {
        let server = match &self.slurm_server {
            Some(server) => server.clone(),
            None if address.contains("//0.0.0.0:") || address.contains("//[::]:") => {
                return Err(BadInput::new(
                    "--slurm-server: name the address at which the nodes reach this service",
                )
                .hint("the service listens on all addresses of this machine; choose one, such as http://farm:7878")
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
        // Processes on the nodes start in another folder, so that paths must be absolute.
        let there = |path: &Path| {
            absolute(path).with_context(|| format!("cannot make the path {} absolute", path.display()))
        };
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
            worker_options: self.slurm_worker_option.clone(),
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

/// The user that owns the reservations, by number: Slurm accepts it as a name.
fn user() -> String {
    rustix::process::getuid().as_raw().to_string()
}

/// Reads a pause of at least a tenth of a second, to spare Slurm's controller.
fn pause(text: &str) -> Result<Duration, String> {
    let pause = duration(text)?;
    if pause < Duration::from_millis(100) {
        Err("the time must be at least 0.1s".to_owned())
    } else {
        Ok(pause)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    #[test]
    fn options_of_slurm_are_refused_where_it_starts_nothing_and_defaults_are_not() {
        let refused =
            |words: &[&str]| parsed::<SlurmOptions>(["serve"].iter().chain(words).copied()).refuse();
        refused(&[]).unwrap();
        for words in [["--slurm-price", "9"], ["--slurm-poll", "6s"], ["--slurm-partition", "render"]] {
            let error = refused(&words).unwrap_err().to_string();
            assert!(error.starts_with(words[0]), "{error}");
        }
    }
}
