//! Generates the shipped scenes. A test compares the output with the committed bundles, so it must be the
//! same on every machine: sines and roots are from `libm`, random numbers are hashes, coordinates are
//! rounded.

pub mod bundle;
pub mod corridor;
pub mod kitchen;
pub mod mesh;
pub mod paint;
pub mod shapes;

/// All scenes that ship with the project.
pub fn scenes() -> Vec<bundle::Scene> {
    vec![kitchen::scene(), corridor::scene()]
}
