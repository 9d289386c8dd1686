//! Forecasts the cost and error of other qualities of a job, from its profile alone. Nothing more is traced.
//!
//! | file | subject |
//! | --- | --- |
//! | `ladder` | settings on a ladder, and rungs worth taking |
//! | `job` | ladders of a job |
//! | `one_frame` | ladders profiled in one frame, applied to all frames |
//! | `noise` | error of the images, from the profiles |

mod job;
mod ladder;
mod noise;
mod one_frame;

pub use ladder::{is_own, ladder, mark, points, without_ladders};
pub use noise::image_error;
