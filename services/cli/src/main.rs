//! The `forelight` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    forelight_cli::main()
}
