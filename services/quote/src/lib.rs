//! From previews and profiles to a quote: pure functions, no I/O.

pub mod living;
