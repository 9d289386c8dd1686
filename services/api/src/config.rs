//! Configuration of the service. Every default is documented where it is set.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use forelight_store::ArtifactPlace;

use crate::clock::{Clock, SystemClock};
use crate::inspector::Inspection;
use crate::oidc::SignInProvider;

/// Configuration of the service.
#[derive(Clone)]
pub struct Config {
    /// Folder of the database and the artefacts. It is created if missing.
    pub data_dir: PathBuf,
    /// Where artefacts are stored. Default: the data folder.
    pub artifacts: ArtifactPlace,
    /// Whether the artefacts were copied there from their former place. Default: no.
    pub artifacts_moved: bool,
    /// Address to listen on. Default: 127.0.0.1:7878, local only. Port 0 picks a free port.
    pub listen: SocketAddr,
    /// Certificate and key, with which the service answers by TLS. Default: none, plain HTTP.
    pub tls: Option<TlsFiles>,
    /// How long a lease lasts without renewal. Default 30 s.
    pub lease_ttl: Duration,
    /// Origin at which people reach the service, such as `https://farm.example.org`, without a path. With
    /// `https`, browsers send the cookies of sessions over TLS only. Default: none.
    pub public_origin: Option<String>,
    /// Origins of other sites whose pages may ask this service, with a token. Default: none.
    pub allowed_origins: Vec<String>,
    /// Through whom people may sign in besides tokens. It needs a public origin. Default: none.
    pub sign_in: Option<SignInProvider>,
    /// How long people stay signed in. Default 7 days.
    pub session_lifetime: Duration,
    /// Folders on shared storage under which jobs may name bundles by path. Default none.
    pub bundle_roots: Vec<PathBuf>,
    /// Folder on shared storage below which images are written for jobs that ask for it. Default: none.
    pub output_root: Option<PathBuf>,
    /// How bundles are loaded.
    pub inspection: Inspection,
    /// Limits on what clients send.
    pub limits: Limits,
    /// Whether results are held against what is possible. Default: they are.
    pub evidence: Evidence,
    /// Source of the time. Default: the system clock.
    pub clock: Arc<dyn Clock>,
}

impl Config {
    /// The defaults, with the data in this folder.
    pub fn new(data_dir: impl Into<PathBuf>) -> Self {
        Self {
            data_dir: data_dir.into(),
            artifacts: ArtifactPlace::DataFolder,
            artifacts_moved: false,
            listen: SocketAddr::from(([127, 0, 0, 1], 7878)),
            tls: None,
            lease_ttl: Duration::from_secs(30),
            public_origin: None,
            allowed_origins: Vec::new(),
            sign_in: None,
            session_lifetime: Duration::from_secs(7 * 86_400),
            bundle_roots: Vec::new(),
            output_root: None,
            inspection: Inspection::default(),
            limits: Limits::default(),
            evidence: Evidence::Checked,
            clock: Arc::new(SystemClock::default()),
        }
    }
}

/// Whether results are held against what is possible: time, work, and the form of files.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Evidence {
    /// A result that is not possible is refused, and held against its node.
    Checked,
    /// Every result is believed: for results that are made up, in tests and measurements.
    Believed,
}

/// Files in PEM form. They are read again when they change.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TlsFiles {
    /// The service's certificate, followed by those that lead to its root.
    pub certificate: PathBuf,
    /// The key of the certificate.
    pub key: PathBuf,
}

/// Limits on everything that a client can make large.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Bytes of an uploaded bundle. Default: 256 MiB.
    pub bundle_bytes: u64,
    /// Bytes of an artefact. Default 1 GiB.
    pub artifact_bytes: u64,
    /// Bytes of a JSON request. Default 1 MiB.
    pub request_bytes: usize,
    /// Bytes of a task's result. Default: 64 MiB, since a preview of many frames with many objects is long.
    pub result_bytes: usize,
    /// Frames of a job. Default 10,000.
    pub frames: u64,
    /// Pixels of an image. Default 2²⁶, 8192 × 8192.
    pub pixels: u64,
    /// Least free disk space in bytes, left for running work and the database's log. Default: 64 MiB.
    pub least_disk_space: u64,
    /// Bundles checked at the same time; others wait. Default: 2.
    pub checks_at_once: usize,
    /// Limits on connections.
    pub connections: ConnectionLimits,
    /// Limits on uploads.
    pub uploads: UploadLimits,
    /// Requests that one token of a person may have under way. Default: 1,024.
    pub requests_per_token: u64,
    /// Answers that take long to compute: so many at the same time. Default: half of the cores, at least 1.
    pub costly_at_once: usize,
    /// Answers that take long to compute: so many may wait for their turn. Default: 16.
    pub costly_waiting: usize,
    /// Limits of a scene.
    pub scene: forelight_scene::Limits,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            bundle_bytes: 256 << 20,
            artifact_bytes: 1 << 30,
            request_bytes: 1 << 20,
            result_bytes: 64 << 20,
            frames: 10_000,
            pixels: 1 << 26,
            least_disk_space: 64 << 20,
            checks_at_once: 2,
            connections: ConnectionLimits::default(),
            uploads: UploadLimits::default(),
            requests_per_token: 1024,
            costly_at_once: std::thread::available_parallelism().map_or(1, |cores| (cores.get() / 2).max(1)),
            costly_waiting: 16,
            scene: forelight_scene::Limits::default(),
        }
    }
}

/// Limits on connections.
#[derive(Clone, Copy, Debug)]
pub struct ConnectionLimits {
    /// Connections at the same time, at least 4. Default: as many as the limit of open files allows, at most
    /// 16,384.
    pub at_once: Option<usize>,
    /// Time in which the head of a request must arrive, counted from the connection's last answer. So a
    /// connection is idle no longer than that. Default: 60 s.
    pub head_time: Duration,
    /// A client that reads nothing of an answer for so long is given up. Default: 60 s.
    pub answer_silence: Duration,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        Self { at_once: None, head_time: Duration::from_secs(60), answer_silence: Duration::from_secs(60) }
    }
}

/// Limits on uploads.
#[derive(Clone, Copy, Debug)]
pub struct UploadLimits {
    /// Least bytes per second of a body, after a grace. Default: 16 KiB.
    pub least_rate: u64,
    /// A body may wait so long for its client besides what the least rate allows. Default: 30 s.
    pub grace: Duration,
    /// A body may wait so long for its client in all. Default: 1 h.
    pub time: Duration,
    /// Bytes that one token of a person may be uploading at the same time. Default: 1 GiB.
    pub bytes_per_token: u64,
}

impl Default for UploadLimits {
    fn default() -> Self {
        Self {
            least_rate: 16 << 10,
            grace: Duration::from_secs(30),
            time: Duration::from_secs(3600),
            bytes_per_token: 1 << 30,
        }
    }
}
