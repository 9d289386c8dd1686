//! The limit of open files and connections of this process.

use crate::failure::BadInput;
use anyhow::Result;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Raises the limit to the system's maximum, and checks that it allows `wanted` files.
///
/// The usual limit of 1024 protects programs that use `select`. A service needs a connection for each worker.
pub fn allow(wanted: u64) -> Result<()> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum {
        // If this fails, the old limit may suffice.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    }
    match getrlimit(Resource::Nofile).current {
        Some(limit) if limit < wanted => Err(BadInput::new(format!(
            "the service needs {wanted} open files and connections, but the system allows {limit}"
        ))
        .hint("raise the limit: ulimit -n")
        .into()),
        _ => Ok(()),
    }
}
