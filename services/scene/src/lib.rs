//! What is there at frame *t*: scene bundles, their geometry, materials, lights and animation.
//!
//! A [`Bundle`] is the folder or zip that a user hands in; [`Scene`] is what it says, for the whole shot;
//! [`Frame`] is the world at one instant, and all that the preview and the tracer ever see.
//!
//! Units: metres, seconds, linear Rec. 709 RGB radiance (W·sr⁻¹·m⁻² per channel); right-handed.

mod animation;
mod assembly;
mod bundle;
mod camera;
mod camera_source;
mod description;
mod error;
mod frame;
mod gltf_file;
mod images;
mod limits;
mod material;
mod mtl;
mod obj;
mod polygon;
mod scene;
mod shot;
mod texture;
mod tracks;

pub use bundle::Bundle;
pub use camera::Camera;
pub use error::{Place, SceneError};
pub use frame::{Environment, Frame, Geometry, PointLight, Strata, Sun};
pub use limits::Limits;
pub use material::{AlphaMask, Color, MOST_NESTED, Material, MaterialClass, Surface};
pub use scene::Scene;
pub use texture::{Texels, Texture, TextureId};
