//! What the loader makes of bundles: the shared ones, small made ones, and malformed ones.

mod bundles;
mod damaged;
mod made;
mod malformed;
mod malformed_gltf;
mod meaning;
mod meaning_gltf;
mod shared;
