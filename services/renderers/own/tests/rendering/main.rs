//! Tasks and quotes of our renderer.

mod cached;
mod quotes;
mod room;
mod sharing;
mod tasks;
