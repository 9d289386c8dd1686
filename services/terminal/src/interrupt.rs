//! Ctrl-C and SIGTERM. The first signal asks for an orderly end, the second ends the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

/// Whether the program has to end.
#[derive(Debug, Clone, Default)]
pub struct Interrupt {
    flag: Arc<AtomicBool>,
    token: CancellationToken,
}

impl Interrupt {
    /// Starts to listen. Requires a runtime.
    pub fn listen() -> std::io::Result<Self> {
        let interrupt = Self::default();
        let (mut interrupted, mut terminated) =
            (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        let told = interrupt.clone();
        tokio::spawn(async move {
            for first in [true, false] {
                tokio::select! {
                    _ = interrupted.recv() => {}
                    _ = terminated.recv() => {}
                }
                if !first {
                    std::process::exit(130);
                }
                told.flag.store(true, Ordering::Relaxed);
                told.token.cancel();
            }
        });
        Ok(interrupt)
    }

    /// The flag, for code that polls.
    pub fn flag(&self) -> &AtomicBool {
        &self.flag
    }

    /// Whether the program has to end.
    pub fn is_set(&self) -> bool {
        self.flag.load(Ordering::Relaxed)
    }

    /// The token, for code that waits.
    pub fn token(&self) -> CancellationToken {
        self.token.clone()
    }
}
