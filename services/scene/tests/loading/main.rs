//! What the loader makes of bundles: the shared ones, small made ones, and malformed ones.

mod bundles;
mod compressed_gltf;
mod damaged;
mod exporters_gltf;
mod exporters_obj;
mod hostile;
mod made;
mod malformed_description;
mod malformed_files;
mod malformed_gltf;
mod malformed_obj;
mod meaning;
mod meaning_gltf;
