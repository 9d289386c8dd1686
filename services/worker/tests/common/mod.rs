//! Shared by tests of qualities.

use forelight_preview::Choice;
use forelight_worker::{AccuracyObserver, Ambient, AmbientShot};
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
pub fn kitchen() -> AmbientShot {
    scene("kitchen")
}

/// One of the shipped scenes.
pub fn scene(name: &str) -> AmbientShot {
    let scenes = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/scenes"));
    Ambient::new(Choice::Cpu).open(&scenes.join(name)).unwrap()
}
