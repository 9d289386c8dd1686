//! Scenes built in code, in `f64`, so that a test can move, turn and scale them before rounding.

use forelight_scene::{
    Camera, Color, Environment, Frame, Geometry, Material, PointLight, Sun, Surface, Texture,
};
use forelight_tracer::{Image, Settings, Tracer};
use glam::{DQuat, DVec3, Vec2, Vec3};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// An opaque material.
pub fn material(surface: Surface, emission: f32) -> Material {
    Material {
        name: "made".into(),
        surface,
        emission: Color::plain(Vec3::splat(emission)),
        emits_both_sides: false,
        opacity: 1.0,
        mask: None,
    }
}

/// Grey Lambert reflection.
pub fn lambert(albedo: f32) -> Surface {
    Surface::Lambert { albedo: grey(albedo) }
}

/// A colour with three equal channels.
pub fn grey(value: f32) -> Color {
    Color::plain(Vec3::splat(value))
}

/// A placement: scale about the origin, then rotation, then translation.
#[derive(Debug, Clone, Copy)]
pub struct Similarity {
    /// Factor on all lengths.
    pub scale: f64,
    /// Rotation.
    pub rotation: DQuat,
    /// Translation.
    pub translation: DVec3,
}

impl Similarity {
    /// The identity.
    pub const NONE: Self = Self { scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// A scale only.
    pub fn scaled(scale: f64) -> Self {
        Self { scale, ..Self::NONE }
    }

    fn point(&self, p: DVec3) -> DVec3 {
        self.rotation * (p * self.scale) + self.translation
    }

    fn direction(&self, d: DVec3) -> DVec3 {
        self.rotation * d
    }
}

/// Eye, target and tangent of half the (square) field of view.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Centre of projection.
    pub eye: DVec3,
    /// Centre of the image.
    pub target: DVec3,
    /// Tangent of half the field of view.
    pub tan_half: f64,
}

impl View {
    /// From `eye` to `target`.
    pub fn new(eye: DVec3, target: DVec3, tan_half: f64) -> Self {
        Self { eye, target, tan_half }
    }
}

/// Shapes, lights and sky. Every shape is its own object.
#[derive(Debug, Clone, Default)]
pub struct World {
    positions: Vec<DVec3>,
    normals: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    strata: Vec<u32>,
    materials: Vec<Material>,
    /// Position and radiant intensity.
    pub points: Vec<(DVec3, f32)>,
    /// Direction to the sun, irradiance, angular diameter in degrees.
    pub suns: Vec<(DVec3, f32, f32)>,
    /// The environment.
    pub environment: Environment,
    /// Images, by index.
    pub textures: Vec<Texture>,
}

impl World {
    /// An empty world under a sky of this radiance.
    pub fn under(sky: f32) -> Self {
        let environment =
            if sky > 0.0 { Environment::Constant(Vec3::splat(sky)) } else { Environment::Black };
        Self { environment, ..Self::default() }
    }

    /// Starts an object of this material and returns its stratum.
    pub fn object(&mut self, material: Material) -> u32 {
        self.materials.push(material);
        self.materials.len() as u32 - 1
    }

    /// Adds a vertex. A zero normal means none.
    pub fn vertex(&mut self, position: DVec3, normal: DVec3) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        self.positions.len() as u32 - 1
    }

    /// Adds a triangle to the last object.
    pub fn triangle(&mut self, corners: [u32; 3]) {
        self.triangles.push(corners);
        self.strata.push(self.materials.len() as u32 - 1);
    }

    /// Adds a mesh without normals, as an object.
    #[must_use]
    pub fn mesh(mut self, positions: &[DVec3], triangles: &[[u32; 3]], material: Material) -> Self {
        self.object(material);
        let first = self.positions.len() as u32;
        for &p in positions {
            self.vertex(p, DVec3::ZERO);
        }
        for t in triangles {
            self.triangle(t.map(|i| first + i));
        }
        self
    }

    /// A parallelogram whose front is towards `u` × `v`.
    #[must_use]
    pub fn quad(self, corner: DVec3, u: DVec3, v: DVec3, material: Material) -> Self {
        self.mesh(&[corner, corner + u, corner + u + v, corner + v], &[[0, 1, 2], [0, 2, 3]], material)
    }

    /// A horizontal square about `centre` of half-width `half` that faces up.
    #[must_use]
    pub fn floor(self, centre: DVec3, half: f64, material: Material) -> Self {
        let (u, v) = (DVec3::new(2.0 * half, 0.0, 0.0), DVec3::new(0.0, 0.0, -2.0 * half));
        self.quad(centre + DVec3::new(-half, 0.0, half), u, v, material)
    }

    /// The same, facing down.
    #[must_use]
    pub fn ceiling(self, centre: DVec3, half: f64, material: Material) -> Self {
        let (u, v) = (DVec3::new(2.0 * half, 0.0, 0.0), DVec3::new(0.0, 0.0, 2.0 * half));
        self.quad(centre + DVec3::new(-half, 0.0, -half), u, v, material)
    }

    /// A box with shared vertices, so that its edges are closed. Fronts are outward, or inward for a room.
    #[must_use]
    pub fn cuboid(self, low: DVec3, high: DVec3, inward: bool, material: Material) -> Self {
        let (positions, triangles) = cuboid(low, high, inward);
        self.mesh(&positions, &triangles, material)
    }

    /// A sphere of 20 · 4^`level` triangles, with smooth normals outward.
    #[must_use]
    pub fn sphere(mut self, centre: DVec3, radius: f64, level: u32, material: Material) -> Self {
        self.object(material);
        let (directions, triangles) = icosphere(level);
        let first = self.positions.len() as u32;
        for n in directions {
            self.vertex(centre + radius * n, n);
        }
        for t in triangles {
            self.triangle(t.map(|i| first + i));
        }
        self
    }

    /// Triangles and positions, as the tracer gets them.
    pub fn geometry(&self, place: &Similarity) -> Geometry {
        let count = self.materials.len() as u32;
        let mut geometry = Geometry {
            positions: self.positions.iter().map(|&p| place.point(p).as_vec3()).collect(),
            normals: self.normals.iter().map(|&n| place.direction(n).as_vec3()).collect(),
            uvs: vec![Vec2::ZERO; self.positions.len()],
            triangles: self.triangles.clone(),
            triangle_stratum: self.strata.clone(),
            ..Geometry::default()
        };
        geometry.strata.objects = (0..count).map(|i| format!("object {i}")).collect();
        geometry.strata.pairs = (0..count).map(|i| (i, i)).collect();
        geometry
    }

    /// The frame of a camera, without a placement.
    pub fn frame(&self, view: View) -> Frame {
        self.frame_at(view, &Similarity::NONE)
    }

    /// The frame of a camera, with everything placed.
    pub fn frame_at(&self, view: View, place: &Similarity) -> Frame {
        let forward = place.direction((view.target - view.eye).normalize());
        let above =
            if forward.cross(place.direction(DVec3::Y)).length() > 1e-3 { DVec3::Y } else { DVec3::Z };
        let right = forward.cross(place.direction(above)).normalize();
        let camera = Camera {
            origin: place.point(view.eye).as_vec3(),
            right: right.as_vec3(),
            up: right.cross(forward).as_vec3(),
            forward: forward.as_vec3(),
            tan_half_x: view.tan_half as f32,
            tan_half_y: view.tan_half as f32,
            width: 1,
            height: 1,
            aperture_radius: 0.0,
            focus_distance: 1.0,
        };
        // Intensity grows with the square of the scale, so irradiance stays the same.
        let grown = (place.scale * place.scale) as f32;
        let point = |&(position, intensity): &(DVec3, f32)| PointLight {
            position: place.point(position).as_vec3(),
            intensity: Vec3::splat(intensity * grown),
            cone: None,
        };
        let sun = |&(direction, irradiance, angle_deg): &(DVec3, f32, f32)| Sun {
            direction: place.direction(direction.normalize()).as_vec3(),
            irradiance: Vec3::splat(irradiance),
            angle_deg,
        };
        Frame {
            number: 0,
            camera,
            geometry: Arc::new(self.geometry(place)),
            materials: self.materials.clone().into(),
            textures: self.textures.clone().into(),
            points: self.points.iter().map(point).collect(),
            suns: self.suns.iter().map(sun).collect(),
            environment: self.environment.clone(),
        }
    }
}

/// A box of shared vertices.
pub fn cuboid(low: DVec3, high: DVec3, inward: bool) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let pick = |i: u32, axis: usize| if i >> axis & 1 == 1 { high[axis] } else { low[axis] };
    let positions = (0..8).map(|i| DVec3::new(pick(i, 0), pick(i, 1), pick(i, 2))).collect();
    let faces: [[u32; 4]; 6] =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut triangles = Vec::new();
    for [a, b, c, d] in faces {
        for [p, q, r] in [[a, b, c], [a, c, d]] {
            triangles.push(if inward { [p, r, q] } else { [p, q, r] });
        }
    }
    (positions, triangles)
}

/// Unit directions and outward triangles of an icosahedron whose triangles are divided into four `level`
/// times.
pub fn icosphere(level: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let mut points: Vec<DVec3> = Vec::new();
    for (a, b) in [(1.0, g), (-1.0, g), (1.0, -g), (-1.0, -g)] {
        points.extend([DVec3::new(0.0, a, b), DVec3::new(a, b, 0.0), DVec3::new(b, 0.0, a)]);
    }
    points.iter_mut().for_each(|p| *p = p.normalize());
    // Faces are the triples of mutual neighbours; an edge spans 63.4°.
    let near = |i: usize, j: usize| points[i].dot(points[j]) > 0.4;
    let mut triangles = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                if near(i, j) && near(j, k) && near(i, k) {
                    let outward = (points[j] - points[i]).cross(points[k] - points[i]).dot(points[i]) > 0.0;
                    let t = [i, j, k].map(|i| i as u32);
                    triangles.push(if outward { t } else { [t[0], t[2], t[1]] });
                }
            }
        }
    }
    for _ in 0..level {
        let mut middles = std::collections::BTreeMap::new();
        let mut finer = Vec::with_capacity(triangles.len() * 4);
        for [a, b, c] in triangles {
            let mut middle = |a: u32, b: u32| {
                *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    points.push((points[a as usize] + points[b as usize]).normalize());
                    points.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    (points, triangles)
}

/// The whole image.
pub fn render(frame: &Frame, settings: &Settings) -> Image {
    Tracer::new(frame, settings).render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels")
}

/// First channel of every pixel.
pub fn values(image: &Image) -> Vec<f64> {
    image.pixels.iter().map(|p| f64::from(p.color[0])).collect()
}

/// Mean of the first channel.
pub fn mean(image: &Image) -> f64 {
    values(image).iter().sum::<f64>() / image.pixels.len() as f64
}

/// Number of pixels with a negative or non-finite channel.
pub fn unsound(image: &Image) -> u64 {
    let sound = |c: &f32| c.is_finite() && *c >= 0.0;
    image.pixels.iter().filter(|p| !p.color.iter().all(sound)).count() as u64
}

/// Everything that two runs must agree on: colours, rays, work.
pub fn bits(image: &Image) -> Vec<([u32; 3], [u32; 7], u64)> {
    image.pixels.iter().map(|p| (p.color.map(f32::to_bits), p.rays, p.work)).collect()
}
