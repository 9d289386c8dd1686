//! Cache of recent answers about plans.

use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::Arc;

use forelight_protocol::AnswersDoc;
use tokio::sync::Semaphore;

const KEPT: usize = 64;

/// Works out answers one at a time and keeps the newest. A key holds everything that its answer depends on.
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
