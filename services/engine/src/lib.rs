//! Engines start worker processes on a cluster. The one engine so far is [`slurm`].
//!
//! An engine runs beside the service and uses its store, not its HTTP API. Each process it starts is an
//! ordinary worker that leases exactly one task. So the lease rules hold even if an engine submits twice,
//! late or never.

pub mod slurm;
