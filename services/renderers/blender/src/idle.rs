//! Blender processes that wait for a question.

use crate::connection::Connection;
use parking_lot::Mutex;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

/// How long a process waits before it is ended: it holds the whole scene in memory.
const PATIENCE: Duration = Duration::from_secs(300);

/// Time between two looks for processes that have waited too long.
const LOOK: Duration = Duration::from_secs(10);

/// Processes that have opened a file, and since when each of them waits.
pub(crate) struct Idle {
    waiting: Arc<Waiting>,
}

type Waiting = Mutex<Vec<(Instant, Connection)>>;

impl Idle {
    /// One process.
    pub fn new(connection: Connection) -> Self {
        let waiting = Arc::new(Mutex::new(vec![(Instant::now(), connection)]));
        let watched = Arc::downgrade(&waiting);
        std::thread::spawn(move || end_those_that_wait(&watched));
        Self { waiting }
    }

    /// A process that lives. The system may have ended one meanwhile, for its memory.
    pub fn take(&self) -> Option<Connection> {
        let mut waiting = self.waiting.lock();
        waiting.retain(|(_, connection)| !connection.has_ended());
        waiting.pop().map(|(_, connection)| connection)
    }

    /// Leaves a process to later questions.
    pub fn put(&self, connection: Connection) {
        self.waiting.lock().push((Instant::now(), connection));
    }
}

/// Ends processes that wait for too long, until the shot is closed.
fn end_those_that_wait(watched: &Weak<Waiting>) {
    loop {
        std::thread::sleep(LOOK);
        let Some(waiting) = watched.upgrade() else { return };
        let ended: Vec<_> = waiting.lock().extract_if(.., |(since, _)| since.elapsed() > PATIENCE).collect();
        // It takes a moment, and questions need not wait for it.
        drop(ended);
    }
}
