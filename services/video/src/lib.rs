//! Videos of finished frames, encoded by ffmpeg: MP4 files with H.264, which browsers and editors play.
//!
//! One thread encodes, by steps that do not depend on the processor. So the same pictures give the same file
//! on all machines that have the same ffmpeg.

mod encoder;
mod task;

pub use encoder::{Encoded, Encoder};
pub use task::VideoTasks;
