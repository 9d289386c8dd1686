//! The renderer's door: what the worker asks of a renderer, in words that suit any of them.
//!
//! | file | subject |
//! | --- | --- |
//! | `door` | the four questions to a renderer: describe, preview, measure, render |
//! | `quoting` | a quote of a shot through the door, without a service |
//! | `process` | foreign programs, held to limits |
//! | `execute` | a task in, a result and its files out; progress, orders and log lines on the way |
//! | `memory` | memory of this process |

pub mod door;
mod execute;
mod memory;
pub mod process;
mod quoting;

pub use execute::{Assignment, Control, Execute, ExecuteError, Outcome};
pub use memory::{peak_rss_bytes, resident_bytes};
pub use quoting::{MeasuredFrame, QuotingError, QuotingStep, ShotQuote, Varied, quote_shot};
