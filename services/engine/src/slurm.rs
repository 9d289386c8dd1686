//! Slurm as the engine: tasks become job arrays, bookings their begin and their reservations, forecasts their time limits.
//!
//! | file | subject |
//! | --- | --- |
//! | `arrays` | which tasks become which arrays: begin, deadline, limit, reservation (pure) |
//! | `command` | what is said to Slurm's programs (pure) |
//! | `answer` | what they answer (pure) |
//! | `next_step` | what an element's state in Slurm and its task's state here call for (pure) |
//! | `cluster` | runs the programs |
//! | `engine` | the loop around all that |
//!
//! # Hazards, and what guards against them
//!
//! * *The service dies between telling Slurm and writing down that it did.* It writes first: an array's row is there before `sbatch` is
//!   called, and its id is the Slurm job's comment. A row without Slurm's number is looked up by that comment, and only if Slurm has known
//!   nothing of it for a minute are its tasks submitted again.
//! * *Slurm runs an element twice.* It does: when a node's daemon dies, its job is put back into the queue while the process goes on. Both
//!   ask for the lease of the same task. One gets it; the other waits while the first is alive, ends with exit code 0 when the task is done,
//!   and gets the lease if the first one dies. What comes late from a process that lost its lease is refused as stale.
//! * *Slurm loses an element, or a person cancels it.* The task is handed out again, with more time if it ran out of it, after a pause that
//!   grows; the sixth time its job fails, with what Slurm said.
//! * *The controller is away.* Nothing is concluded from silence: everything waits, and an event says so.
//! * *A deadline that cannot be met makes Slurm cancel the job.* So an array has a deadline only if the latest of its frames could start as
//!   booked and take its whole time limit; whatever is handed out again has none.

mod answer;
mod arrays;
mod cluster;
mod command;
mod engine;
mod next_step;

pub use cluster::{Cluster, ClusterError, Programs};
pub use command::Submitting;
pub use engine::{Engine, Options};
