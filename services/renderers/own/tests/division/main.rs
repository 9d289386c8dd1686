//! Frames divided into parts.

mod costs;
