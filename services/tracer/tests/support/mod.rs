//! Small scenes built in code.
#![allow(dead_code, missing_docs)] // every test file uses its own part

use forelight_scene::{Camera, Color, Environment, Frame, Geometry, Material, Surface};
use glam::{Vec2, Vec3};
use std::sync::Arc;

pub fn lambert(albedo: f32) -> Surface {
    Surface::Lambert { albedo: Color::plain(Vec3::splat(albedo)) }
}

pub fn material(name: &str, surface: Surface, emission: f32) -> Material {
    Material {
        name: name.into(),
        surface,
        emission: Color::plain(Vec3::splat(emission)),
        emits_both_sides: false,
        opacity: 1.0,
        mask: None,
    }
}

/// Collects shapes; every shape is an object of its own material.
#[derive(Default)]
pub struct Builder {
    geometry: Geometry,
    materials: Vec<Material>,
}

impl Builder {
    fn object(&mut self, material: Material) -> u32 {
        let id = self.materials.len() as u32;
        self.geometry.strata.objects.push(material.name.clone());
        self.geometry.strata.pairs.push((id, id));
        self.materials.push(material);
        id
    }

    fn vertex(&mut self, position: Vec3, normal: Vec3) -> u32 {
        self.geometry.positions.push(position);
        self.geometry.normals.push(normal);
        self.geometry.uvs.push(Vec2::ZERO);
        self.geometry.positions.len() as u32 - 1
    }

    fn triangle(&mut self, corners: [u32; 3], stratum: u32) {
        self.geometry.triangles.push(corners);
        self.geometry.triangle_stratum.push(stratum);
    }

    /// Front towards `u × v`.
    pub fn quad(mut self, corner: Vec3, u: Vec3, v: Vec3, material: Material) -> Self {
        let id = self.object(material);
        let p = [corner, corner + u, corner + u + v, corner + v].map(|p| self.vertex(p, Vec3::ZERO));
        self.triangle([p[0], p[1], p[2]], id);
        self.triangle([p[0], p[2], p[3]], id);
        self
    }

    /// Normals outward, or inward for a room.
    pub fn cuboid(mut self, low: Vec3, high: Vec3, inward: bool, material: Material) -> Self {
        let id = self.object(material);
        for axis in 0..3 {
            for side in 0..2 {
                let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
                let corner = |s: usize, t: usize| {
                    let mut p = [0.0; 3];
                    p[axis] = if side == 1 { high[axis] } else { low[axis] };
                    p[a] = if s == 1 { high[a] } else { low[a] };
                    p[b] = if t == 1 { high[b] } else { low[b] };
                    Vec3::from(p)
                };
                let c = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)]
                    .map(|p| self.vertex(p, Vec3::ZERO));
                let order = if (side == 1) != inward { [0, 1, 2, 3] } else { [0, 3, 2, 1] };
                self.triangle([c[order[0]], c[order[1]], c[order[2]]], id);
                self.triangle([c[order[0]], c[order[2]], c[order[3]]], id);
            }
        }
        self
    }

    /// A finely tessellated sphere with smooth normals.
    pub fn sphere(mut self, centre: Vec3, radius: f32, material: Material) -> Self {
        let id = self.object(material);
        let (rings, sectors) = (64u32, 128u32);
        let first = self.geometry.positions.len() as u32;
        for i in 0..=rings {
            let theta = std::f32::consts::PI * i as f32 / rings as f32;
            for j in 0..=sectors {
                let phi = std::f32::consts::TAU * j as f32 / sectors as f32;
                let n = Vec3::new(theta.sin() * phi.cos(), theta.cos(), -theta.sin() * phi.sin());
                self.vertex(centre + radius * n, n);
            }
        }
        for i in 0..rings {
            for j in 0..sectors {
                let at = |i: u32, j: u32| first + i * (sectors + 1) + j;
                if i > 0 {
                    self.triangle([at(i, j), at(i + 1, j), at(i, j + 1)], id);
                }
                if i + 1 < rings {
                    self.triangle([at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)], id);
                }
            }
        }
        self
    }

    pub fn frame(self, origin: Vec3, target: Vec3, size: u32, environment: Environment) -> Frame {
        let forward = (target - origin).normalize();
        let right = forward.cross(Vec3::Y).normalize();
        Frame {
            number: 0,
            camera: Camera {
                origin,
                right,
                up: right.cross(forward),
                forward,
                tan_half_x: 0.5,
                tan_half_y: 0.5,
                width: size,
                height: size,
                aperture_radius: 0.0,
                focus_distance: 1.0,
            },
            geometry: Arc::new(self.geometry),
            materials: self.materials.into(),
            textures: Vec::new().into(),
            points: Vec::new(),
            suns: Vec::new(),
            environment,
        }
    }
}

/// Everything at once: diffuse, glossy, glass, pane, area light, sky.
pub fn everything() -> Frame {
    let color = Color::plain(Vec3::new(0.9, 0.8, 0.7));
    let plastic = Surface::Plastic { albedo: color, ior: 1.5, alpha: 0.1 };
    let glass = Surface::Glass { ior: 1.5, transmittance: color, alpha: 0.0, priority: None };
    let pane = Surface::ThinGlass { ior: 1.5, transmittance: color };
    Builder::default()
        .quad(
            Vec3::new(-5.0, -1.0, 5.0),
            Vec3::new(10.0, 0.0, 0.0),
            Vec3::new(0.0, 0.0, -10.0),
            material("floor", lambert(0.6), 0.0),
        )
        .sphere(Vec3::new(-0.8, 0.0, 0.0), 0.7, material("glass", glass, 0.0))
        .sphere(Vec3::new(0.8, -0.2, 0.0), 0.7, material("plastic", plastic, 0.0))
        .quad(Vec3::new(-0.4, -1.0, 1.0), Vec3::X, Vec3::Y, material("pane", pane, 0.0))
        .quad(Vec3::new(-0.5, 3.0, -0.5), Vec3::X, Vec3::Z, material("light", lambert(0.0), 20.0))
        .frame(Vec3::new(0.0, 0.5, 4.0), Vec3::ZERO, 40, Environment::Constant(Vec3::splat(0.2)))
}
