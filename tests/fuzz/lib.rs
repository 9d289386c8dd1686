//! The parsers that tests mutate the input of, for fuzz targets.

#[path = "../support/parsers.rs"]
pub mod parsers;
