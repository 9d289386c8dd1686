//! Reports of benches: on a terminal, and as a section of a Markdown file.

mod blocks;
mod origin;
pub mod page;

pub use blocks::{Report, share};
pub use origin::Origin;
