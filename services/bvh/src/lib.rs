//! Bounding volume hierarchy: finds the closest triangle that a ray hits, or whether it hits any.
//!
//! `obvhs` builds a binary tree (PLOC with reinsertion). It is then collapsed to eight children per node at
//! the least expected cost. The traversal is our own, for three reasons:
//! * It counts its steps ([`Traversal`]). These counts are a measure of cost that is the same in every run.
//! * Its triangle test is watertight.
//! * It tests eight boxes and four triangles at a time.
//!
//! The following holds for every processor, thread and tree shape:
//! * A closed mesh has no cracks. Shared edges are decided by sign alone, in f64 where the f32 result is zero
//!   (Woop, Benthin and Wald 2013). A ray through an edge or a corner hits one of the triangles that share
//!   it.
//! * Among triangles at exactly the same distance, the one with the lowest index wins.
//! * The portable and the AVX2 kernel return the same bits and the same counts.

mod build;
mod collapse;
mod kernel;
mod node;
mod ray;
mod traverse;
mod triangle;

pub use node::Bvh;
pub use ray::{Hit, Ray, Traversal, offset_origin, size_of};

#[cfg(test)]
mod tests;
