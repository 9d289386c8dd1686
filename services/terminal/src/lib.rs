//! Code that the commands and benches of `forelight` share: flags, bundles on this machine, output (tables,
//! units, progress bars, plots), and files.

pub mod atomic_file;
pub mod bounded_file;
pub mod cost_picture;
pub mod failure;
pub mod foreign;
pub mod foreign_text;
pub mod interrupt;
pub mod json_file;
pub mod local;
pub mod open_files;
pub mod options;
pub mod output;
pub mod quantities;
pub mod table;
pub mod watching;
