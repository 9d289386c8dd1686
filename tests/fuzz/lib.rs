//! The parsers whose input tests mutate, for fuzz targets.

#[path = "../support/foreign.rs"]
pub mod foreign;
#[path = "../support/parsers.rs"]
pub mod parsers;
#[path = "../support/routes.rs"]
pub mod routes;
