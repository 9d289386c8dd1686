//! What tests of qualities share.

use forelight_preview::Choice;
use forelight_worker::{AccuracyObserver, Ambient, AmbientShot};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Watches; stops everything if its flag is set.
#[derive(Default)]
pub struct Nobody(pub AtomicBool);

impl AccuracyObserver for Nobody {
    fn predicted(&self, _: usize, _: usize) {}
    fn cancel(&self) -> &AtomicBool {
        &self.0
    }
}

/// The kitchen that ships with the project.
pub fn kitchen() -> AmbientShot {
    scene("kitchen")
}

/// One of the scenes that ship with it.
pub fn scene(name: &str) -> AmbientShot {
    let scenes = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/scenes"));
    Ambient::new(Choice::Cpu).open(&scenes.join(name)).unwrap()
}
