//! `forelight serve`: the service without workers. `forelight farm` starts its service by the same code.

use crate::commands::sign_in;
use crate::commands::slurm::SlurmOptions;
use crate::failure::PORT_HINT;
use anyhow::{Context, Result};
use clap::ValueEnum;
use forelight_api::{Config, Service, TlsFiles};
use forelight_client::Token;
use forelight_engine::slurm::Engine;
use forelight_protocol::{Role, Timestamp};
use forelight_store::{ArtifactPlace, Store, tokens};
use forelight_terminal::atomic_file::write_secret;
use forelight_terminal::failure::BadInput;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::duration;
use forelight_terminal::output;
use std::fs;
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// Run the service without workers; workers connect over HTTP
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight serve --data farm-data --listen 0.0.0.0:7878 --bundle-root /mnt/shots
  forelight serve --data farm-data --artifacts s3://renders/farm
  forelight serve --data /shared/farm --listen 10.0.0.5:7878 --executor slurm --slurm-partition render
  forelight worker --server http://farm:7878 --token-file worker.token
  forelight serve --listen 0.0.0.0:7878 --tls-certificate farm.pem --tls-key farm.key --public-url https://farm:7878

The first start writes a token for each role into DATA/tokens, readable by you alone. `forelight token` makes more. \
The service speaks plain HTTP, unless it has a certificate. Outside of a trusted network, give it one, or put it \
behind a TLS proxy.")]
pub struct Args {
    #[command(flatten)]
    service: ServiceOptions,
}

#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Service")]
pub struct ServiceOptions {
    /// Folder of the database, the artefacts and the tokens. It is created if it does not exist
    #[arg(long, value_name = "DIR", default_value = "farm-data")]
    pub data: PathBuf,
    /// Where to keep images, profiles and bundles: data-folder, or s3://BUCKET/PREFIX. Server and credentials
    /// come from AWS_ENDPOINT_URL, AWS_REGION, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY.
    /// AWS_ALLOW_HTTP=true permits a server without TLS
    #[arg(long, value_name = "PLACE", default_value = "data-folder")]
    pub artifacts: ArtifactPlace,
    /// Confirm that this farm's artefacts have been copied to the place that --artifacts names
    #[arg(long)]
    pub artifacts_moved: bool,
    /// Address and port to listen on. Port 0 picks a free port
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7878", value_parser = address)]
    pub listen: SocketAddr,
    /// Certificate in PEM form, with which the service answers by TLS, followed by those that lead to its
    /// root. It is read again when it changes
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_certificate: Option<PathBuf>,
    /// Key of the certificate in PEM form
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    pub tls_key: Option<PathBuf>,
    /// Time until a lease expires without renewal, such as 30s
    #[arg(long, value_name = "DURATION", default_value = "30s", value_parser = duration)]
    pub lease_ttl: Duration,
    /// Address at which people reach the service, if it is another one, such as `https://farm.example.org`
    /// behind a TLS proxy. Links begin with it. With https, browsers send sessions over TLS only
    #[arg(long, value_name = "URL", value_parser = origin)]
    pub public_url: Option<String>,
    /// Origin of another site whose pages may ask this service with a token, such as
    /// `https://pipeline.example.org`. May be repeated
    #[arg(long, value_name = "URL", value_parser = origin)]
    pub allow_origin: Vec<String>,
    /// File that describes the studio's OpenID Connect provider, through which people sign in besides tokens:
    /// see docs/operating.md. Needs --public-url
    #[arg(long, value_name = "FILE", requires = "public_url")]
    pub sign_in: Option<PathBuf>,
    /// Folder on shared storage below which jobs may name bundles by path. May be repeated
    #[arg(long, value_name = "DIR")]
    pub bundle_root: Vec<PathBuf>,
    /// Folder on shared storage below which images are written for jobs that ask for it by `submit --output`
    #[arg(long, value_name = "DIR")]
    pub output_root: Option<PathBuf>,
    /// Largest bundle that clients may upload, MiB
    #[arg(long, value_name = "MIB", default_value_t = 256, value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    pub max_bundle: u64,
    /// Largest number of frames of a job
    #[arg(long, value_name = "COUNT", default_value_t = 10_000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub max_frames: u64,
    /// Largest number of pixels of an image
    #[arg(long, value_name = "COUNT", default_value_t = 1 << 26, value_parser = clap::value_parser!(u64).range(1..=1 << 28))]
    pub max_pixels: u64,
    /// Largest number of triangles of a scene
    #[arg(long, value_name = "COUNT", default_value_t = 50_000_000, value_parser = clap::value_parser!(u64).range(1..))]
    pub max_triangles: u64,
    /// Largest number of connections. Beyond that, quiet ones that have shown no token are closed first. Default:
    /// as many as the limit of open files allows (ulimit -n), at most 16384
    #[arg(long, value_name = "COUNT", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(4..=1 << 20))]
    pub max_connections: Option<usize>,
    /// What starts the processes that do the tasks
    #[arg(long, value_name = "WHO", default_value = "workers")]
    pub executor: Executor,
    #[command(flatten)]
    pub slurm: SlurmOptions,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Executor {
    /// People start workers: `forelight worker`, or `forelight farm` on its own machine.
    Workers,
    /// Slurm starts them: tasks are job arrays, bookings reservations, and forecasts time limits.
    Slurm,
}

impl ServiceOptions {
    /// Refuses options that would have no effect.
    pub fn check(&self) -> Result<()> {
        if self.executor == Executor::Slurm { Ok(()) } else { self.slurm.refuse() }
    }

    fn config(&self) -> Result<Config> {
        let mut config = Config::new(&self.data);
        // This program loads bundles for itself. Without its path, the service does that inside.
        config.inspection.program = std::env::current_exe().ok();
        config.artifacts.clone_from(&self.artifacts);
        config.artifacts_moved = self.artifacts_moved;
        config.listen = self.listen;
        config.tls = self
            .tls_certificate
            .clone()
            .zip(self.tls_key.clone())
            .map(|(certificate, key)| TlsFiles { certificate, key });
        config.lease_ttl = self.lease_ttl;
        config.public_origin.clone_from(&self.public_url);
        config.allowed_origins.clone_from(&self.allow_origin);
        config.bundle_roots.clone_from(&self.bundle_root);
        config.output_root.clone_from(&self.output_root);
        config.limits.bundle_bytes = self.max_bundle << 20;
        config.limits.frames = self.max_frames;
        config.limits.pixels = self.max_pixels;
        config.limits.scene.triangles = self.max_triangles;
        config.limits.connections.at_once = self.max_connections;
        config.sign_in = self.sign_in.as_deref().map(sign_in::read).transpose()?;
        Ok(config)
    }
}

/// Reads an address to listen on.
fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| {
        "expected an IP address and a port, such as 0.0.0.0:7878 for all networks or 127.0.0.1:7878"
            .to_owned()
    })
}

/// Reads `https://farm.example.org` or `http://10.0.0.5:7878/`: scheme, host and port, without a path.
fn origin(text: &str) -> Result<String, String> {
    let plain = text.trim_end_matches('/');
    let rest = plain.strip_prefix("https://").or_else(|| plain.strip_prefix("http://"));
    let is_host = |rest: &str| !rest.is_empty() && !rest.contains(['/', '?', '#', '@', ' ']);
    match rest {
        Some(rest) if is_host(rest) => Ok(plain.to_owned()),
        _ => Err("expected http:// or https://, a host, and a port if it is not the usual one".to_owned()),
    }
}

pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    args.service.check()?;
    let running = start(&args.service).await?;
    output::line(running.greeting())?;
    output::line(format!("dashboard at {}/", running.public_address()))?;
    interrupt.token().cancelled().await;
    running.shutdown().await;
    Ok(())
}

pub struct Running {
    pub service: Service,
    data: PathBuf,
    public_url: Option<String>,
    over_tls: bool,
    /// The operator's token, which signs the person in who started the farm.
    operator: String,
    engine: Option<(JoinHandle<()>, CancellationToken)>,
}

impl Running {
    pub fn address(&self) -> String {
        let scheme = if self.over_tls { "https" } else { "http" };
        format!("{scheme}://{}", self.service.local_addr())
    }

    /// The address for processes of this machine, without TLS.
    pub fn home_address(&self) -> String {
        format!("http://{}", self.service.home_addr())
    }

    /// The operator's token. The workers of `forelight farm` use it, since its person also says what they
    /// cost.
    pub fn operator_token(&self) -> Token {
        Token::new(&self.operator)
    }

    /// The address for people: that of --public-url, or one at which this machine reaches the service.
    pub fn public_address(&self) -> String {
        self.public_url.clone().unwrap_or_else(|| reachable(&self.address()))
    }

    /// A link that signs in once, as an operator, within five minutes.
    pub async fn sign_in_link(&self) -> Result<String> {
        let store = self.service.store();
        let now = Timestamp::now();
        let caller = tokens::find(store, &self.operator, now).await?;
        let caller = caller.context("the farm does not know its operator's token")?;
        let code = store.create_session_code(&caller, now).await?.code;
        Ok(sign_in_link(&self.public_address(), &code))
    }

    /// Ends the engine, then the service. Slurm's jobs go on, and the next start finds them again.
    pub async fn shutdown(self) {
        if let Some((engine, stop)) = self.engine {
            stop.cancel();
            if let Err(error) = engine.await {
                tracing::warn!(%error, "the engine failed while it was ending");
            }
        }
        self.service.shutdown().await;
    }

    /// The address and the operator token's file, for the person who started it.
    pub fn greeting(&self) -> String {
        let token = token_path(&self.data, Role::Operator);
        format!("listening on {}\noperator token in {}", self.address(), token.display())
    }
}

/// Fails if the service could not listen on its address now.
pub fn check_address(options: &ServiceOptions) -> Result<(), BadInput> {
    TcpListener::bind(options.listen).map(drop).map_err(|error| {
        BadInput::new(format!("--listen: cannot listen on {}: {error}", options.listen)).hint(PORT_HINT)
    })
}

/// Starts the service, and creates the first tokens if they are missing.
pub async fn start(options: &ServiceOptions) -> Result<Running> {
    let data = options.data.display();
    // What a farm writes is for its user alone: names of unreleased films, images, hashes of tokens.
    rustix::process::umask(rustix::fs::Mode::RWXG | rustix::fs::Mode::RWXO);
    // Each worker has a connection, and the service needs some files itself.
    forelight_terminal::open_files::allow(256)?;
    let service = Service::start(options.config()?)
        .await
        .with_context(|| format!("cannot start the service with data in {data}"))?;
    let operator = first_tokens(service.store(), &options.data)
        .await
        .with_context(|| format!("cannot create the tokens in {data}"))?;
    let mut running = Running {
        service,
        data: options.data.clone(),
        public_url: options.public_url.clone(),
        over_tls: options.tls_certificate.is_some(),
        operator,
        engine: None,
    };
    if options.executor == Executor::Slurm {
        let logs = options.data.join("slurm");
        fs::create_dir_all(&logs).with_context(|| format!("cannot create the folder {}", logs.display()))?;
        let token = token_path(&options.data, Role::Worker);
        let chosen = options.slurm.engine(&running.address(), &logs, &token)?;
        let engine =
            Engine::start(running.service.store().clone(), chosen).await.context("cannot use Slurm")?;
        let stop = CancellationToken::new();
        running.engine = Some((tokio::spawn(engine.run(stop.clone())), stop));
    }
    Ok(running)
}

fn token_path(data: &Path, role: Role) -> PathBuf {
    data.join("tokens").join(format!("{role}.token"))
}

/// Link to the page that signs in with a one-time code. Browsers do not send what follows `#`.
pub fn sign_in_link(address: &str, code: &str) -> String {
    format!("{}/#/sign-in?code={code}", address.trim_end_matches('/'))
}

/// The address at which this machine reaches its own service.
pub fn reachable(address: &str) -> String {
    address.replace("//0.0.0.0:", "//127.0.0.1:").replace("//[::]:", "//[::1]:")
}

/// Writes a token file for each role, if it is missing, and returns the operator's token. A
/// file with a token that is unknown, expired or of another role is replaced. The token that an earlier start
/// wrote into it then ends.
async fn first_tokens(store: &Store, data: &Path) -> Result<String> {
    let mut operator = None;
    let now = Timestamp::now();
    for role in Role::ALL {
        let path = token_path(data, role);
        let known = match fs::read_to_string(&path) {
            Ok(text) if tokens::find(store, text.trim(), now).await?.is_some_and(|it| it.role == role) => {
                Some(text)
            }
            _ => None,
        };
        let text = match known {
            Some(text) => text,
            None => {
                let text = store.create_first_token(role, now).await?;
                write_secret(&path, text.as_bytes())?;
                text
            }
        };
        if role == Role::Operator {
            operator = Some(text.trim().to_owned());
        }
    }
    operator.context("the list of roles lacks the operator")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_service_that_listens_everywhere_is_reached_at_home() {
        assert_eq!(reachable("http://0.0.0.0:7878"), "http://127.0.0.1:7878");
        assert_eq!(reachable("http://[::]:1"), "http://[::1]:1");
        assert_eq!(reachable("http://10.0.0.7:80"), "http://10.0.0.7:80");
    }

    #[test]
    fn a_public_address_is_an_origin_without_a_path() {
        assert_eq!(origin("https://farm.example.org/").as_deref(), Ok("https://farm.example.org"));
        assert_eq!(origin("http://[::1]:7878").as_deref(), Ok("http://[::1]:7878"));
        for wrong in ["farm.example.org", "ftp://farm", "https://", "https://farm/x", "https://a@b", ""] {
            assert!(origin(wrong).is_err(), "{wrong}");
        }
        assert_eq!(sign_in_link("http://farm:1/", "c"), "http://farm:1/#/sign-in?code=c");
    }

    #[tokio::test]
    async fn tokens_are_made_once_kept_and_replaced_where_the_farm_does_not_know_them() {
        let data = tempfile::tempdir().unwrap();
        let store = Store::open(data.path()).await.unwrap();
        first_tokens(&store, data.path()).await.unwrap();
        let read = |role| fs::read_to_string(token_path(data.path(), role)).unwrap();
        let (operator, viewer) = (read(Role::Operator), read(Role::Viewer));
        let mode = fs::metadata(token_path(data.path(), Role::Operator)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        // The viewer's file now holds a token that is real, but not a viewer's.
        fs::write(token_path(data.path(), Role::Viewer), &operator).unwrap();
        first_tokens(&store, data.path()).await.unwrap();
        assert_eq!(read(Role::Operator), operator);
        assert_ne!(read(Role::Viewer), viewer);
        assert_ne!(read(Role::Viewer), operator);
        // The token that was replaced is dead.
        assert!(tokens::find(&store, &viewer, Timestamp::now()).await.unwrap().is_none());
        assert_eq!(tokens::count(&store).await.unwrap(), 4);
    }
}
