//! The renderer's door: what the worker asks of a renderer, in words that suit any of them.
//!
//! | file | subject |
//! | --- | --- |
//! | `execute` | a task in, a result and its files out; progress, orders and log lines on the way |
//! | `memory` | memory of this process |

mod execute;
mod memory;

pub use execute::{Assignment, Control, Execute, ExecuteError, Outcome};
pub use memory::{peak_rss_bytes, resident_bytes};
