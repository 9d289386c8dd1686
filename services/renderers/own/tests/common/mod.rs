//! Shared by tests of qualities.

use forelight_preview::Choice;
use forelight_renderer_own::{AccuracyObserver, OwnRenderer, OwnShot};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Cancels if its flag is set.
#[derive(Default)]
pub struct Nobody(pub AtomicBool);

impl AccuracyObserver for Nobody {
    fn predicted(&self, _: usize, _: usize) {}
    fn cancel(&self) -> &AtomicBool {
        &self.0
    }
}

/// The shipped kitchen.
pub fn kitchen() -> OwnShot {
    scene("kitchen")
}

/// One of the shipped scenes.
pub fn scene(name: &str) -> OwnShot {
    let scenes = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/scenes"));
    OwnRenderer::new(Choice::Cpu).open(&scenes.join(name)).unwrap()
}
