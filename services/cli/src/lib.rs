//! What the `forelight` program does. Each command is a file under `commands`; code that they share is beside
//! it.

mod archive;
mod arguments;
mod caches;
mod commands;
mod connection;
mod contact_sheet;
mod data_folder;
mod failure;
mod job_options;
mod named;
mod storage;

use forelight_terminal::foreign_text::log_fields;
use std::io::{IsTerminal, Write as _};
use std::process::ExitCode;
use std::time::Duration;
use tracing_subscriber::EnvFilter;

/// The whole program, which ends with this code.
pub fn main() -> ExitCode {
    quiet_display_lookup();
    let (cli, flags) = arguments::read();
    log(cli.verbosity());
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => {
            say(&format!("error: cannot start: {error}"));
            return ExitCode::FAILURE;
        }
    };
    let outcome = runtime.block_on(cli.run());
    // A thread that hangs, such as on a file server that is gone, must not hold the end of the program.
    runtime.shutdown_timeout(LAST_THREADS);
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&failure::describe(&error, &flags));
            ExitCode::from(failure::exit_code(&error))
        }
    }
}

/// Time for threads to end that still work when the command has ended.
const LAST_THREADS: Duration = Duration::from_secs(5);

fn say(words: &str) {
    // If this write fails, there is no other place to report it.
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
    // The crates' log targets begin with `forelight_`, which the filter `forelight` includes.
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .fmt_fields(log_fields())
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        // A log line that cannot be written is dropped. A report on standard error would panic.
        .log_internal_errors(false)
        .init();
}

/// Sets `XDG_RUNTIME_DIR` if it is missing, because graphics drivers complain on standard error without it.
fn quiet_display_lookup() {
    const RUNTIME_FOLDER: &str = "XDG_RUNTIME_DIR";
    if std::env::var_os(RUNTIME_FOLDER).is_none() {
        // SAFETY: the program begins with this, when no other thread exists that could read the environment.
        unsafe { std::env::set_var(RUNTIME_FOLDER, std::env::temp_dir()) };
    }
}
