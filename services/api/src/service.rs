//! The running service: start, background work, and shutdown.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use forelight_store::{Store, StoreError};
use tokio::net::{TcpListener, TcpSocket};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::background::in_background;
use crate::clock::{Clock as _, SteadyClock};
use crate::config::Config;
use crate::connections::{Tls, TlsError, serve};
use crate::costly::Costly;
use crate::feed::Feed;
use crate::inspector::Inspector;
use crate::low_priority::LowPriority;
use crate::metrics::Metrics;
use crate::oidc::{SignIn, SignInProvider};
use crate::output_root::OutputRoot;
use crate::quotas::Quotas;
use crate::router::{openapi_yaml, router};
use crate::shared::Changes;
use crate::state::{App, InFlight};
use crate::uploads::Reserved;

/// Time allowed for running requests when the service stops.
const LAST_ANSWERS: Duration = Duration::from_secs(10);

/// Why the service cannot run.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The data folder cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: std::io::Error,
    },
    /// The system starts no threads.
    #[error("cannot start threads: {0}")]
    Threads(std::io::Error),
    /// The sign-in provider cannot be used.
    #[error("the sign-in provider: {0}")]
    SignIn(String),
    /// TLS cannot be served.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The output root cannot be opened.
    #[error("output root {path}: {source}")]
    OutputRoot {
        /// Its path.
        path: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// A bundle root does not exist.
    #[error("bundle root {path}: {source}")]
    BundleRoot {
        /// Its path.
        path: String,
        /// The system's error.
        source: std::io::Error,
    },
}

/// A running service. Dropping it stops it; [`Service::shutdown`] waits for that.
pub struct Service {
    address: SocketAddr,
    home: SocketAddr,
    store: Store,
    stopping: CancellationToken,
    tasks: Vec<JoinHandle<()>>,
}

impl Service {
    /// Opens the data folder, resumes earlier work, and serves. The service is reachable when this returns.
    pub async fn start(config: Config) -> Result<Self, ServiceError> {
        let tls = config.tls.map(Tls::new).transpose()?;
        let public_origin = config.public_origin;
        let sign_in =
            config.sign_in.map(|provider| sign_in_through(provider, public_origin.as_deref())).transpose()?;
        let roots = config.bundle_roots.into_iter().map(bundle_root).collect::<Result<Arc<[_]>, _>>()?;
        let output_root = config.output_root.as_deref().map(open_output_root).transpose()?;
        let clock = Arc::new(SteadyClock::new(config.clock));
        let store = Store::open_with(&config.data_dir, &config.artifacts, config.artifacts_moved).await?;
        let low_priority = LowPriority::start().map_err(ServiceError::Threads)?;
        store.connect().await?;
        let others = [store.for_service(), store.for_people()];
        let connect = async move { futures::future::try_join_all(others.iter().map(Store::connect)).await };
        let connected = low_priority.handle().spawn(connect).await;
        connected.map_err(|error| ServiceError::Threads(error.into()))??;
        let extended = store.extend_leases_after_start(config.lease_ttl, clock.now()).await?;
        if extended > 0 {
            tracing::info!(leases = extended, "leases from before the start were extended");
        }
        let (listener, address) = bind(config.listen)?;
        // With TLS, the processes of this machine reach the service without it, by the loopback alone.
        let at_home = match &tls {
            Some(_) => Some(bind(SocketAddr::from(([127, 0, 0, 1], 0)))?),
            None => None,
        };
        let stopping = CancellationToken::new();
        let limits = config.limits;
        let connections = limits.connections;
        let (conductor, jobs) = mpsc::unbounded_channel();
        let app = App {
            store: store.clone(),
            low_priority: low_priority.clone(),
            clock: clock.clone(),
            lease_ttl: config.lease_ttl,
            is_over_tls: tls.is_some()
                || public_origin.as_deref().is_some_and(|it| it.starts_with("https://")),
            public_origin: public_origin.map(Into::into),
            sign_in,
            session_lifetime: config.session_lifetime,
            sign_ins: Arc::default(),
            rights: Arc::default(),
            webhooks_changed: Arc::new(watch::Sender::new(0)),
            bundle_roots: roots,
            output_root,
            inspector: Arc::new(Inspector::new(config.inspection, limits.scene, limits.checks_at_once)),
            costly: Costly::new(limits.costly_at_once, limits.costly_waiting),
            quotas: Quotas::default(),
            reserved: Reserved::default(),
            limits: Arc::new(limits),
            evidence: config.evidence,
            metrics: Arc::new(Metrics::default()),
            stopping: stopping.clone(),
            conductor,
            in_flight: InFlight::default(),
            pruning: Arc::default(),
            feed: Arc::new(Feed::new(store.for_people())),
            dashboard: Arc::default(),
            summaries: Arc::default(),
            projected: Arc::default(),
            record: Arc::default(),
            clock_steps: Arc::default(),
            changes: Changes::new(),
            openapi: openapi_yaml,
        };
        // From here on, no right ends unseen.
        app.end_rights().await;
        let router = router(app.clone(), &config.allowed_origins);
        let mut tasks = in_background(&app, jobs, clock);
        let mut home = address;
        if let Some((listener, address)) = at_home {
            home = address;
            tasks.push(tokio::spawn(serve(listener, router.clone(), None, connections, stopping.clone())));
        }
        if let Some(tls) = &tls {
            tasks.push(tokio::spawn(tls.clone().follow_files(stopping.clone())));
        }
        tasks.push(tokio::spawn(serve(listener, router, tls, connections, stopping.clone())));
        Ok(Self { address, home, store, stopping, tasks })
    }

    /// The address it listens on.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// The address at which processes of this machine reach it without TLS: the same one if it has none.
    pub fn home_addr(&self) -> SocketAddr {
        self.home
    }

    /// Its store, for making tokens in the same process.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Takes no more requests, ends waits and event streams, finishes running requests, closes the database.
    pub async fn shutdown(mut self) {
        self.stopping.cancel();
        for mut task in self.tasks.drain(..) {
            if tokio::time::timeout(LAST_ANSWERS, &mut task).await.is_err() {
                tracing::warn!("a running request took too long and is dropped");
                task.abort();
            }
        }
        self.store.close().await;
    }
}

fn sign_in_through(provider: SignInProvider, origin: Option<&str>) -> Result<Arc<SignIn>, ServiceError> {
    provider.check().map_err(ServiceError::SignIn)?;
    let origin = origin.ok_or_else(|| {
        ServiceError::SignIn("it needs the address at which people reach the service".to_owned())
    })?;
    Ok(Arc::new(SignIn::new(provider, origin).map_err(ServiceError::SignIn)?))
}

fn bundle_root(root: PathBuf) -> Result<PathBuf, ServiceError> {
    root.canonicalize()
        .map_err(|source| ServiceError::BundleRoot { path: root.display().to_string(), source })
}

fn open_output_root(path: &Path) -> Result<OutputRoot, ServiceError> {
    let failed = |source| ServiceError::OutputRoot { path: path.display().to_string(), source };
    OutputRoot::open(path).map_err(failed)
}

/// Connections that may wait to be accepted: a farm's workers and pages all come back at once after a restart. The
/// system drops more, and their clients try again a second later. It lowers this to its own limit
/// (`net.core.somaxconn`).
const BACKLOG: u32 = 4096;

/// Listens on an address. Port 0 picks a free port.
fn bind(address: SocketAddr) -> Result<(TcpListener, SocketAddr), ServiceError> {
    let failed = |source| ServiceError::Listen { address, source };
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }.map_err(failed)?;
    // A service that starts again takes its port back at once.
    socket.set_reuseaddr(true).map_err(failed)?;
    socket.bind(address).map_err(failed)?;
    let listener = socket.listen(BACKLOG).map_err(failed)?;
    let bound = listener.local_addr().map_err(failed)?;
    Ok((listener, bound))
}

impl Drop for Service {
    fn drop(&mut self) {
        self.stopping.cancel();
        for task in &self.tasks {
            task.abort();
        }
    }
}
