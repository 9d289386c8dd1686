//! Foreign programs, held to limits.
//!
//! A program is started without a shell, in a process group of its own, with exactly the environment that is
//! named. It ends when its run is cancelled, when it exceeds a limit, and when this process dies. Nothing of
//! it is left behind: processes that it started are killed with it, those that left its group too.
//!
//! | file | subject |
//! | --- | --- |
//! | `program` | what is started |
//! | `question` | a program that only says its version, or what it can |
//! | `sandbox` | what it may write, read and reach, if the worker says so |
//! | `session` | a running program: lines in and out, orders |
//! | `exchange` | a running program that answers bytes |
//! | `supervisor` | the thread that starts, measures, limits, ends and reaps it |
//! | `group` | the processes of a run, by `/proc` |
//! | `orphans` | what a killed process left behind |
//! | `lines` | output as lines of bounded length |
//! | `messages` | what known messages mean |
//!
//! Without a sandbox, a foreign program runs with the rights of this process: it can read and write what this
//! process can, and a process that leaves the group *and* clears its environment is not found.

mod exchange;
mod group;
mod lines;
mod messages;
mod orphans;
mod program;
mod question;
mod sandbox;
mod session;
mod supervisor;

pub use exchange::{Exchange, MOST_BYTES};
pub use lines::{LONGEST_LINE, Line, Stream};
pub use messages::{COMMON_MESSAGES, Meaning, Message};
pub use orphans::end_orphans;
pub use program::Program;
pub use question::ask;
pub use sandbox::Sandbox;
pub use session::{Finished, Session, run, run_on_files};
pub use supervisor::Usage;
