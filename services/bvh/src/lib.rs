//! Which triangle does a ray meet first, and does it meet any?
//!
//! The tree is built by `obvhs` (PLOC with reinsertion), collapsed to eight children a node at the least expected cost, and
//! traversed by our own loop, for three reasons: it counts what it does ([`Traversal`]), so that cost is a number that two runs agree
//! on; its triangle test is watertight; and it tests eight boxes and four triangles at a time.
//!
//! What holds, whatever the processor, the thread or the shape of the tree:
//! * a closed mesh has no cracks: shared edges are decided by sign alone, in f64 where f32 says zero
//!   (Woop, Benthin, Wald 2013), and a ray through an edge or a corner meets one of the triangles that share it;
//! * of several triangles at exactly the same distance the one of the lowest index wins;
//! * the portable and the AVX2 kernel return the same bits, and count the same.

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
