//! What other qualities of a job cost, and how far their images are from converged: from its profile alone. Nothing is
//! traced for it.
//!
//! | file | subject |
//! | --- | --- |
//! | `ladder` | which settings are on a ladder, and which rungs are worth taking |
//! | `job` | the ladders of a job |
//! | `one_frame` | ladders that were profiled in one frame, brought to all frames |
//! | `noise` | what the profiles say of the image's error |

mod job;
mod ladder;
mod noise;
mod one_frame;

pub use ladder::{is_own, ladder, mark, points, without_ladders};
