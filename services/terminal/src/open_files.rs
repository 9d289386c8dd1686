//! How many files and connections this process may have open.

use crate::failure::BadInput;
use anyhow::Result;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Raises the limit as far as the system lets every process, and says whether that is enough for so many.
///
/// The usual limit of 1024 is there for programs that cannot handle more (`select`); a service with a connection for
/// each worker can.
pub fn allow(wanted: u64) -> Result<()> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum {
        // Should that fail, the limit is what it was, which may do.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    }
    match getrlimit(Resource::Nofile).current {
        Some(limit) if limit < wanted => Err(BadInput::new(format!(
            "{wanted} files and connections are to be open at the same time, and the system allows {limit}"
        ))
        .hint("raise the limit: ulimit -n")
        .into()),
        _ => Ok(()),
    }
}
