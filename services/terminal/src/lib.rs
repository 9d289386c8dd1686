//! What the commands and the benches of `forelight` have in common: flags, a bundle opened on this machine, what is printed (tables, units,
//! progress bars, plots), and the files that are read and written.

pub mod atomic_file;
pub mod bounded_file;
pub mod cost_picture;
pub mod failure;
pub mod interrupt;
pub mod json_file;
pub mod local;
pub mod open_files;
pub mod options;
pub mod output;
pub mod quantities;
pub mod table;
pub mod watching;
