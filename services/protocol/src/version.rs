//! Versions: what workers and service agree on when they talk.

/// Version of the messages between workers and service. A worker states its own in
/// [`WORKER_PROTOCOL_HEADER`]. Raise this when a service of the version before cannot work with a new worker.
pub const WORKER_PROTOCOL: u32 = 4;

/// The oldest version of a worker that this service understands. Workers that state none have version 1.
pub const OLDEST_WORKER_PROTOCOL: u32 = 1;

/// The header in which a worker states its version, with every request to register, to join and to claim.
pub const WORKER_PROTOCOL_HEADER: &str = "forelight-worker-protocol";
