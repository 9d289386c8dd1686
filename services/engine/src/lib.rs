//! What starts the processes that do a farm's tasks, where those are not workers that were started by hand: [`slurm`].
//!
//! An engine stands beside the service and knows its memory, not its HTTP; a process that it starts speaks to the service like every
//! other worker, and leases exactly one task. So the rules of leases hold whatever an engine does twice, late or not at all.

pub mod slurm;
