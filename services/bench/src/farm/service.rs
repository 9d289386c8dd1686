//! Runs the service in its own process.

use anyhow::{Context, Result, bail};
use forelight_protocol::Role;
use forelight_terminal::failure::BadInput;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A temporary folder for databases, below `parent` or the system's default.
pub fn temporary_folder(parent: Option<&Path>) -> Result<TempDir> {
    let Some(parent) = parent else { return Ok(tempfile::tempdir()?) };
    let folder = tempfile::tempdir_in(parent);
    Ok(folder.map_err(|error| BadInput::new(format!("--folder {}: {error}", parent.display())))?)
}

/// The service in its own process. Dropping this value kills it.
pub struct ServiceProcess {
    child: Child,
    pub address: String,
    pub token: String,
    tokens: PathBuf,
}

impl ServiceProcess {
    /// Starts `forelight serve` with this data folder, and waits until it listens.
    pub fn start(data: &Path) -> Result<Self> {
        let output = data.with_extension("out");
        let child = Command::new(std::env::current_exe().context("cannot find this program")?)
            .args(["serve", "--listen", "127.0.0.1:0", "--data"])
            .arg(data)
            .stdin(Stdio::null())
            .stdout(fs::File::create(&output)?)
            .stderr(Stdio::null())
            .env("RUST_LOG", "warn")
            .spawn()
            .context("cannot start the service")?;
        let tokens = data.join("tokens");
        let mut service = Self { child, address: String::new(), token: String::new(), tokens };
        let start = Instant::now();
        while service.address.is_empty() {
            if let Some(status) = service.child.try_wait()? {
                bail!("the service exited: {status}");
            }
            if start.elapsed() > Duration::from_secs(60) {
                bail!("the service did not listen within a minute");
            }
            std::thread::sleep(Duration::from_millis(20));
            let printed = fs::read_to_string(&output)?;
            if let Some((line, _)) = printed.split_once('\n') {
                service.address = line.trim_start_matches("listening on ").to_owned();
            }
        }
        service.token = service.token_of(Role::Worker)?;
        Ok(service)
    }

    /// The token of a role.
    pub fn token_of(&self, role: Role) -> Result<String> {
        let path = self.tokens.join(format!("{role}.token"));
        let token = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(token.trim().to_owned())
    }

    /// A value of `/proc/PID/status`, in bytes.
    pub fn status_bytes(&self, name: &str) -> Result<u64> {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id()))?;
        let line = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
        let kibibytes = line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
        Ok(kibibytes.with_context(|| format!("/proc has no {name} of the service"))? * 1024)
    }

    pub fn cpu_seconds(&self) -> Result<f64> {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.child.id()))?;
        // The name in brackets may hold anything. The state and then numbers follow it.
        let rest = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
        let ticks: Vec<f64> =
            rest.split_whitespace().skip(11).take(2).filter_map(|n| n.parse().ok()).collect();
        let [user, system] = ticks[..] else { bail!("/proc has no CPU times of the service") };
        /// Linux reports hundredths of a second, whatever the kernel's tick.
        const TICKS: f64 = 100.0;
        Ok((user + system) / TICKS)
    }
}

impl Drop for ServiceProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
