//! Bounding volume hierarchy: finds the closest triangle that a ray hits, or whether it hits any.
//!
//! `obvhs` builds a binary tree (PLOC with reinsertion), which is collapsed to eight children per node. The
//! traversal counts its steps ([`Traversal`]), the same in every run. It tests eight boxes and four triangles
//! at a time. On every processor, thread and tree shape:
//! * A closed mesh has no cracks. Shared edges are decided by sign alone, in f64 where the f32 result is zero
//!   (Woop, Benthin and Wald 2013).
//! * Among triangles at exactly the same distance, the one with the lowest index wins.
//! * The portable and the AVX2 kernel return the same bits and the same counts.

mod build;
mod bytes;
mod collapse;
mod kernel;
mod node;
mod ray;
mod reinsertion;
mod traverse;
mod triangle;

pub use node::Bvh;
pub use ray::{Hit, Ray, Traversal, offset_origin, size_of};

#[cfg(test)]
mod tests;
