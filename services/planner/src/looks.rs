//! How much a plan looks at.

use std::cell::Cell;
use std::rc::Rc;

/// Counts what is looked at: gaps, frames, places and numbers. Clones share their count.
#[derive(Clone, Debug, Default)]
pub(crate) struct Looks(Rc<Cell<u64>>);

impl Looks {
    pub fn add(&self, looks: usize) {
        self.0.set(self.0.get().saturating_add(looks as u64));
    }

    pub fn count(&self) -> u64 {
        self.0.get()
    }
}
