//! Runs the program as users do. Processes are killed when a test ends.

use crate::http::Http;
use crate::waiting::eventually;
use forelight_protocol::{ByClass, NodeCalibration, Role, Timestamp};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::time::Duration;

/// Time for a process to start or to stop on any machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Lines of a log to show when a test fails.
const LAST_WORDS: usize = 25;

/// The program: `FORELIGHT_BIN`, or `forelight` in the folder that the tests were built into.
pub fn binary() -> PathBuf {
    let found = std::env::var_os("FORELIGHT_BIN").map(PathBuf::from).or_else(|| {
        // target/debug/deps/chaos-0123456789abcdef
        let test = std::env::current_exe().ok()?;
        Some(test.parent()?.parent()?.join("forelight"))
    });
    let path = found.unwrap_or_default();
    assert!(
        path.is_file(),
        "there is no program at {}: build it first (cargo build -p forelight-cli), or name it by FORELIGHT_BIN",
        path.display()
    );
    path
}

/// Runs a command of the program to its end.
pub fn run<A: AsRef<OsStr>>(arguments: &[A]) -> Output {
    let mut command = Command::new(binary());
    command.args(arguments).stdin(Stdio::null()).env_remove("RUST_LOG");
    for variable in ["FORELIGHT_SERVER", "FORELIGHT_TOKEN"] {
        command.env_remove(variable);
    }
    command.output().expect("the program can be run")
}

/// Runs a command that must succeed, and returns its output.
pub fn run_well<A: AsRef<OsStr>>(arguments: &[A]) -> String {
    let output = run(arguments);
    let words: Vec<_> = arguments.iter().map(|argument| argument.as_ref().to_string_lossy()).collect();
    assert!(
        output.status.success(),
        "forelight {}: {}: {}",
        words.join(" "),
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).expect("what is printed is UTF-8")
}

/// A process of the program. Dropping this value kills it.
pub struct Process {
    child: Child,
    /// File of its standard output.
    output: PathBuf,
    /// File of its log.
    log: PathBuf,
    /// Time of its start.
    pub started: Timestamp,
}

impl Process {
    /// Starts the program. Its output and log go to files in `logs` that begin with `name`.
    pub fn start<A: AsRef<OsStr>>(logs: &Path, name: &str, arguments: &[A]) -> Self {
        Self::start_with(logs, name, Command::new(binary()), arguments, &[])
    }

    /// Starts it by this command, with these environment variables.
    fn start_with<A: AsRef<OsStr>>(
        logs: &Path,
        name: &str,
        mut command: Command,
        arguments: &[A],
        environment: &[(String, PathBuf)],
    ) -> Self {
        let (output, log) = (logs.join(format!("{name}.out")), logs.join(format!("{name}.log")));
        let file =
            |path: &Path| File::create(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let started = Timestamp::now();
        let child = command
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(file(&output))
            .stderr(file(&log))
            .env_remove("RUST_LOG")
            .envs(environment.iter().map(|(name, value)| (name, value)))
            .spawn()
            .expect("the program can be started");
        Self { child, output, log, started }
    }

    /// Its output so far.
    pub fn printed(&self) -> String {
        fs::read_to_string(&self.output).unwrap_or_default()
    }

    /// Its exit status, if it has ended.
    pub fn has_ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().expect("a child can be asked")
    }

    /// `kill -9`. The process must be alive.
    pub fn kill(mut self) {
        assert_eq!(self.has_ended(), None, "it ended before it was killed: {}", self.last_words());
        self.child.kill().expect("a child can be killed");
        let status = self.child.wait().expect("a child can be waited for");
        assert_eq!(status.signal(), Some(9), "{status}");
    }

    /// Sends a signal by name: `STOP`, `CONT`, `TERM`.
    pub fn signal(&self, signal: &str) {
        let line = format!("kill -{signal} {}", self.child.id());
        let sent = Command::new("sh").args(["-c", &line]).status().expect("a shell can be run");
        assert!(sent.success(), "{line}");
    }

    /// Asks it to stop, waits, and requires success.
    pub async fn end(mut self) {
        self.signal("TERM");
        let status = eventually("the end of a process", PATIENCE, async || self.has_ended()).await;
        assert!(status.success(), "{status}: {}", self.last_words());
    }

    /// The last lines of its log.
    pub fn last_words(&self) -> String {
        let log = fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        lines[lines.len().saturating_sub(LAST_WORDS)..].join("\n")
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if std::thread::panicking() {
            println!("---- the end of {}\n{}", self.log.display(), self.last_words());
        }
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A shell that sets a limit and then becomes the program.
fn limited(limit: &str) -> Command {
    let mut shell = Command::new("sh");
    shell.args(["-c", &format!("{limit} && exec \"$0\" \"$@\"")]).arg(binary());
    shell
}

/// A service with its data in a temporary folder: `forelight serve`, or `forelight farm` with workers.
pub struct Service {
    folder: tempfile::TempDir,
    arguments: Vec<String>,
    environment: Vec<(String, PathBuf)>,
    /// A line of a shell that limits the process.
    limit: Option<&'static str>,
    process: Option<Process>,
    address: String,
    starts: u32,
}

impl Service {
    /// Starts `command` (`serve` or `farm`) on a free port with these flags, and waits until it is ready.
    pub async fn start(command: &str, flags: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let mut service = Self::prepared(folder, command, flags);
        service.launch().await;
        service
    }

    /// The same under a limit, which a line of a shell sets.
    pub async fn limited(command: &str, flags: &[&str], limit: &'static str) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let mut service = Self { limit: Some(limit), ..Self::prepared(folder, command, flags) };
        service.launch().await;
        service
    }

    /// A service that is not started yet, with its data in this folder.
    pub fn prepared(folder: tempfile::TempDir, command: &str, flags: &[&str]) -> Self {
        let data = folder.path().join("data");
        let mut arguments = vec![command.to_owned(), "--data".to_owned(), data.display().to_string()];
        arguments.extend(flags.iter().map(|&flag| flag.to_owned()));
        let (environment, address) = (Vec::new(), String::new());
        Self { folder, arguments, environment, limit: None, process: None, address, starts: 0 }
    }

    /// Sets these environment variables for all later starts.
    pub fn set_environment(&mut self, environment: &[(&str, &Path)]) {
        let owned = |&(name, value): &(&str, &Path)| (name.to_owned(), value.to_owned());
        self.environment = environment.iter().map(owned).collect();
    }

    /// Starts it for the first time, on a free port, and waits until it is ready.
    pub async fn launch(&mut self) {
        self.listen("127.0.0.1:0").await;
    }

    async fn listen(&mut self, listen: &str) {
        self.starts += 1;
        let mut arguments = self.arguments.clone();
        arguments.extend(["--listen".to_owned(), listen.to_owned()]);
        let name = format!("service-{}", self.starts);
        let command = self.limit.map_or_else(|| Command::new(binary()), limited);
        let folder = self.folder.path();
        let mut process = Process::start_with(folder, &name, command, &arguments, &self.environment);
        let address = eventually("the service's address", PATIENCE, async || {
            assert_eq!(process.has_ended(), None, "the service ended: {}", process.last_words());
            let printed = process.printed();
            let (line, _) = printed.split_once('\n')?;
            Some(line.strip_prefix("listening on ").expect("the address comes first").to_owned())
        })
        .await;
        self.process = Some(process);
        self.address = address;
        // Tokens exist before the address is printed.
        let http = self.anonymous();
        let ready = eventually("the service to be ready", PATIENCE, async || {
            http.request(reqwest::Method::GET, "/readyz").send().await.ok()
        });
        assert_eq!(ready.await.status(), reqwest::StatusCode::OK);
    }

    /// `kill -9`.
    pub fn kill(&mut self) {
        self.process.take().expect("the service runs").kill();
    }

    /// Starts it again after a kill, with the same data and address.
    pub async fn start_again(&mut self) {
        assert!(self.process.is_none(), "the service runs");
        let address = self.address.clone();
        let listen = address.strip_prefix("http://").expect("an address of HTTP");
        self.listen(listen).await;
        assert_eq!(self.address, address);
    }

    /// Asks it to stop, and waits. The data stay until this value is dropped.
    pub async fn end(&mut self) {
        self.process.take().expect("the service runs").end().await;
    }

    /// The folder of its database, artefacts and tokens.
    pub fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// A folder for other files of the test.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// `http://host:port`.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The file of a role's token.
    pub fn token_file(&self, role: Role) -> PathBuf {
        self.data().join("tokens").join(format!("{role}.token"))
    }

    /// A client with this role.
    pub fn http(&self, role: Role) -> Http {
        let path = self.token_file(role);
        let token = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Http::new(&self.address, Some(token.trim().to_owned()))
    }

    /// A client without a token.
    pub fn anonymous(&self) -> Http {
        Http::new(&self.address, None)
    }

    /// Starts a worker with one thread whose node is `name`. All workers share the folder of fetched bundles.
    pub fn worker(&self, name: &str, process: &str) -> Process {
        self.worker_at(&self.address, name, process, "1m")
    }

    /// Starts a worker with another address and interval of checkpoints.
    pub fn worker_at(&self, address: &str, name: &str, process: &str, checkpoints: &str) -> Process {
        let (token, bundles) = (self.token_file(Role::Worker), self.folder().join("bundles"));
        let calibration = self.folder().join("calibration.json");
        if !calibration.exists() {
            // Measuring would take longer than many workers live.
            let picos_per_work = ByClass::from_array([1000; ByClass::CLASSES]);
            let made = NodeCalibration { picos_per_work, kernels: Vec::new() };
            fs::write(&calibration, serde_json::to_vec(&made).unwrap()).unwrap();
        }
        let arguments: [&OsStr; 18] = [
            "worker".as_ref(),
            "--server".as_ref(),
            address.as_ref(),
            "--token-file".as_ref(),
            token.as_ref(),
            "--name".as_ref(),
            name.as_ref(),
            "--threads".as_ref(),
            "1".as_ref(),
            "--preview".as_ref(),
            "cpu".as_ref(),
            "--bundles".as_ref(),
            bundles.as_ref(),
            "--checkpoints".as_ref(),
            checkpoints.as_ref(),
            "--calibration".as_ref(),
            calibration.as_ref(),
            "-v".as_ref(),
        ];
        Process::start(self.folder(), process, &arguments)
    }
}
