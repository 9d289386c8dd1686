//! Generates the shipped scenes: shapes, textures, the bundle writer, and the scenes themselves.
//!
//! The output must be the same on every machine, because a test compares it with the committed bundles. Sines
//! and roots therefore come from the `libm` crate, random numbers are hashes of indices, and every coordinate
//! is rounded when it is written.

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
