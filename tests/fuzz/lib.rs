//! The parsers whose input tests mutate, for fuzz targets.

#[path = "../support/parsers.rs"]
pub mod parsers;
