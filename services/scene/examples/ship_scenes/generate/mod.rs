//! The generator of the shipped scenes: shapes, textures, the bundle writer, and the scenes themselves.
//!
//! What it writes must be the same on every machine, because a test holds the committed bundles against it. So
//! sines and roots come from the `libm` crate rather than from the system, random numbers are hashes of
//! indices, and every coordinate is rounded when it is written.

pub mod bundle;
pub mod corridor;
pub mod kitchen;
pub mod mesh;
pub mod paint;
pub mod shapes;

/// Every scene that ships with the project.
pub fn scenes() -> Vec<bundle::Scene> {
    vec![kitchen::scene(), corridor::scene()]
}
