//! Slurm as the engine. Tasks become job arrays, bookings become begin times and reservations, forecasts
//! become time limits.
//!
//! | file | subject |
//! | --- | --- |
//! | `arrays` | groups tasks into arrays: begin, deadline, limit, reservation (pure) |
//! | `command` | arguments for Slurm's programs (pure) |
//! | `answer` | output of Slurm's programs (pure) |
//! | `next_step` | what to do about an element, from its state in Slurm and in the store (pure) |
//! | `cluster` | runs the programs |
//! | `engine` | the loop |
//!
//! # Hazards
//!
//! * *The service dies between `sbatch` and its write.* The array's row is written before `sbatch` runs, and
//!   its id is the Slurm job's comment. A row without Slurm's number is looked up by that comment. Its tasks
//!   are submitted again only after Slurm has not known it for a minute.
//! * *Slurm runs an element twice.* When a node's daemon dies, Slurm requeues the job while the process goes
//!   on. Both processes claim the same lease. The second waits, and gets the lease only if the first dies. If
//!   the task is done, it exits with code 0. Late results are refused as stale.
//! * *Slurm loses an element, or a person cancels it.* The task is submitted again after a growing pause,
//!   with a longer limit after a timeout. The sixth loss fails its job with Slurm's reason.
//! * *The controller is away.* Nothing is concluded from silence. All tasks wait, and an event says so.
//! * *Slurm cancels jobs that cannot meet their deadline.* So an array gets a deadline only if its last
//!   frame, started as booked, could use its whole limit. Resubmitted tasks get none.

mod answer;
mod arrays;
mod cluster;
mod command;
mod engine;
mod next_step;

pub use cluster::{Cluster, ClusterError, Programs};
pub use command::Submitting;
pub use engine::{Engine, Options};

/// Whether output can be read as that of `squeue`, of `sinfo` and of `sbatch`.
pub fn can_read(output: &[u8]) -> [bool; 3] {
    [
        answer::jobs(output).is_ok(),
        answer::nodes(output, Some("all")).is_ok(),
        answer::submitted(output).is_ok(),
    ]
}
