//! Small worlds built in code, and the makers of previews that this machine has.
#![allow(dead_code)] // each test file uses its part

use forelight_preview::{Choice, PreviewError, Previewer};
use forelight_scene::{
    AlphaMask, Camera, Color, Environment, Frame, Geometry, Material, Surface, Texels, Texture, TextureId,
};
use forelight_test_needs::not_run;
use glam::{Vec2, Vec3};
use std::sync::Arc;

/// A world under construction. Every surface is an object and a material of its own.
#[derive(Default)]
pub struct World {
    pub geometry: Geometry,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
}

impl World {
    /// Adds a parallelogram of two triangles as a new stratum, with texture coordinates 0 to 1 along the
    /// edges.
    pub fn quad(&mut self, corner: Vec3, edge_u: Vec3, edge_v: Vec3, material: Material) -> u32 {
        let first = self.geometry.positions.len() as u32;
        self.geometry.positions.extend([corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v]);
        self.geometry.uvs.extend([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
        self.geometry.normals.extend([Vec3::ZERO; 4]);
        let stratum = self.geometry.strata.pairs.len() as u32;
        self.geometry.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        self.geometry.triangle_stratum.extend([stratum; 2]);
        self.geometry.strata.objects.push(format!("quad {stratum}"));
        self.geometry.strata.pairs.push((stratum, stratum));
        self.materials.push(material);
        stratum
    }

    /// Adds a quad that faces +z, centred on (`x`, `y`, `z`).
    pub fn facing(&mut self, centre: Vec3, size: f32, material: Material) -> u32 {
        let half = size / 2.0;
        self.quad(centre - Vec3::new(half, half, 0.0), Vec3::X * size, Vec3::Y * size, material)
    }

    /// The frame of this world as seen by `camera`.
    pub fn frame(self, camera: Camera) -> Frame {
        Frame {
            number: 0,
            camera,
            geometry: Arc::new(self.geometry),
            materials: self.materials.into(),
            textures: self.textures.into(),
            points: Vec::new(),
            suns: Vec::new(),
            environment: Environment::Black,
        }
    }
}

/// A grey Lambert material.
pub fn grey() -> Material {
    Material {
        name: "grey".into(),
        surface: Surface::Lambert { albedo: Color::plain(Vec3::splat(0.5)) },
        emission: Color::plain(Vec3::ZERO),
        emits_both_sides: false,
        opacity: 1.0,
        mask: None,
    }
}

/// A grey material cut out by a texture at alpha ½.
pub fn cut_out(texture: u32) -> Material {
    Material { mask: Some(AlphaMask { texture: TextureId(texture), cutoff: 0.5 }), ..grey() }
}

/// A texture of the given alpha values, the top row first.
pub fn alpha_texture(width: u32, alpha: &[u8]) -> Texture {
    Texture {
        name: "alpha".into(),
        width,
        height: alpha.len() as u32 / width,
        texels: Texels::Srgb8(alpha.iter().map(|&a| [255, 255, 255, a]).collect()),
    }
}

/// A camera at the origin that looks along −z and sees 45° to each side.
pub fn camera(width: u32, height: u32) -> Camera {
    Camera {
        origin: Vec3::ZERO,
        right: Vec3::X,
        up: Vec3::Y,
        forward: Vec3::NEG_Z,
        tan_half_x: 1.0,
        tan_half_y: height as f32 / width as f32,
        width,
        height,
        aperture_radius: 0.0,
        focus_distance: 1.0,
    }
}

/// The GPU. Where there is none, the test counts as not run, in part at least. One that is there has to work.
pub fn gpu() -> Option<Previewer> {
    match Previewer::new(Choice::Gpu) {
        Ok(gpu) => Some(gpu),
        Err(error @ PreviewError::NoDevice(_)) => {
            not_run(format_args!("no GPU preview: {error}"));
            None
        }
        Err(error) => panic!("the GPU cannot be used: {error}"),
    }
}

/// Every maker of previews that this machine has.
pub fn makers() -> Vec<Previewer> {
    let cpu = Previewer::new(Choice::Cpu).expect("the CPU is always there");
    std::iter::once(cpu).chain(gpu()).collect()
}
