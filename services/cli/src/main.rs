//! `forelight`: the one binary. Every command is in a file of its own under `commands`; what several of them need is beside it.

mod archive;
mod caches;
mod commands;
mod connection;
mod contact_sheet;
mod failure;
mod job_options;

use clap::Parser;
use std::io::{IsTerminal, Write as _};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    quiet_display_lookup();
    let cli = commands::Cli::parse();
    log(cli.verbosity());
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => {
            say(&format!("error: cannot start: {error}"));
            return ExitCode::FAILURE;
        }
    };
    match runtime.block_on(cli.run()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&failure::describe(&error));
            ExitCode::from(failure::exit_code(&error))
        }
    }
}

/// The last words, for whoever reads them.
fn say(words: &str) {
    // There is nowhere else to say that nobody can hear it.
    let _ = writeln!(std::io::stderr(), "{words}");
}

/// Logs go to standard error, so that standard output holds results alone.
fn log(verbosity: u8) {
    let default = match verbosity {
        0 => "warn",
        1 => "warn,forelight=info",
        2 => "info,forelight=debug",
        _ => "debug,forelight=trace",
    };
    // Crates of this project are logged under names that begin with `forelight_`, which the filter `forelight` includes.
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        // What cannot be written, for a disk is full or nobody reads it, is lost. To say so on standard error would panic.
        .log_internal_errors(false)
        .init();
}

/// Graphics drivers look for a display by this variable, and complain on standard error where it is missing. No display is
/// wanted here, and standard error is for this program's own words.
fn quiet_display_lookup() {
    const RUNTIME_FOLDER: &str = "XDG_RUNTIME_DIR";
    if std::env::var_os(RUNTIME_FOLDER).is_none() {
        // SAFETY: this is called first thing in `main`, when no other thread exists that could read the environment meanwhile.
        unsafe { std::env::set_var(RUNTIME_FOLDER, std::env::temp_dir()) };
    }
}
