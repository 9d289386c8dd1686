//! Answers about plans that were worked out a moment ago.

use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::Arc;

use forelight_protocol::AnswersDoc;
use tokio::sync::Semaphore;

/// Answers that are kept.
const KEPT: usize = 64;

/// Works answers out, one at a time, and keeps the newest: by the plan and everything else that they rest on.
pub(crate) struct AnswerCache {
    pub turn: Semaphore,
    kept: Mutex<VecDeque<([u8; 32], Arc<AnswersDoc>)>>,
}

impl Default for AnswerCache {
    fn default() -> Self {
        Self { turn: Semaphore::new(1), kept: Mutex::default() }
    }
}

impl AnswerCache {
    pub fn find(&self, key: &[u8; 32]) -> Option<Arc<AnswersDoc>> {
        let kept = self.kept.lock();
        kept.iter().find(|(other, _)| other == key).map(|(_, document)| document.clone())
    }

    pub fn keep(&self, key: [u8; 32], document: Arc<AnswersDoc>) {
        let mut kept = self.kept.lock();
        kept.push_front((key, document));
        kept.truncate(KEPT);
    }
}
