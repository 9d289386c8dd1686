//! Scenes: bundles, geometry, materials, lights and animation.
//!
//! A [`Bundle`] is the folder or zip file that a user submits, a [`Scene`] its content for the whole shot, a
//! [`Frame`] the world at one instant. Units are metres, seconds and linear Rec. 709 RGB radiance (W·sr⁻¹·m⁻²
//! per channel). Coordinates are right-handed.

mod animation;
mod assembly;
mod bulk;
mod bundle;
mod camera;
mod camera_source;
mod checker;
mod description;
mod error;
mod frame;
mod gltf_file;
mod images;
mod kept_scene;
mod light_source;
mod limits;
mod material;
mod mtl;
mod obj;
mod obj_text;
mod polygon;
mod regular_file;
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
pub use regular_file::{open_no_link, open_regular};
pub use scene::Scene;
pub use texture::{Texels, Texture, TextureId};
