//! The scenes of the calibration.
//!
//! | kernel | most of its work |
//! | --- | --- |
//! | `coherent` | neighbouring camera rays through a small tree |
//! | `incoherent` | gather rays in a room of matt, mirror and glass boxes: most like a frame |
//! | `traversal` | the same in a closed room with six thousand triangles, which fit into CPU caches |
//! | `memory` | the same with half a million triangles, which do not fit |
//! | `lights` | a glossy floor under a lamp: rays that meet nothing |
//! | `surfaces` | a floor without light: the surface that each camera ray meets |
//! | `texture` | sheets cut out by an image: one lookup for each that a ray passes |
//! | `records` | the room again, read from an irradiance cache |
//! | `build` | the tree of hills of fifty thousand triangles |

use crate::costs::by_class;
use forelight_protocol::ByClass;
use forelight_scene::{
    AlphaMask, Camera, Color, Environment, Frame, Geometry, Material, Strata, Surface, Texels, Texture,
    TextureId,
};
use forelight_tracer::{CacheSettings, Cost, Settings, Totals, Tracer};
use glam::{Vec2, Vec3};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The kernel that is most like a frame.
pub const REFERENCE: &str = "incoherent";

/// Edge of the images in pixels.
const SIZE: u32 = 48;

/// Boxes along an edge of the room: 6916 triangles in all, which fit into CPU caches.
const BOXES: u32 = 24;

/// Balls in the closed room, and rings per ball. A ball of n rings has 4 n (n − 1) triangles.
const BALLS: u32 = 256;
const FEW: u32 = 3;
const MANY: u32 = 23;

/// Squares along an edge of the hills, with two triangles each.
const BUILT: u32 = 160;

/// Sheets of the texture kernel, and the edge of their image in texels: 16 MiB.
const SHEETS: u32 = 24;
const TEXELS: u32 = 2048;

/// Something to run and to time.
pub struct Kernel {
    pub name: &'static str,
    /// Its time on the reference core, relative to what rates of whole frames predict.
    pub beyond: f64,
    does: Does,
}

enum Does {
    /// Traces these pixels.
    Trace(Box<Tracer>, Vec<u32>),
    /// Builds this frame's tree.
    Build(Box<Frame>, Settings),
}

impl Kernel {
    /// Runs the kernel. Returns its work and its nanoseconds.
    pub fn run(&self) -> (ByClass, u64) {
        match &self.does {
            Does::Trace(tracer, pixels) => {
                let (before, _) = tracer.work_by_class();
                let nanos = Totals::of(tracer.profile(pixels).iter()).cpu_nanos;
                let (after, _) = tracer.work_by_class();
                let triangles = tracer.frame().geometry.triangles.len();
                (by_class(std::array::from_fn(|class| after[class] - before[class]), triangles), nanos)
            }
            Does::Build(frame, settings) => {
                let Cost { work, cpu_nanos } = Tracer::new(frame, settings).tree_cost().build;
                (ByClass { build: work, ..ByClass::default() }, cpu_nanos)
            }
        }
    }
}

pub fn all() -> Vec<Kernel> {
    let settings = Settings { width: SIZE, height: SIZE, ambient_bounces: 0, ..Settings::default() };
    let with =
        |spp, ambient_bounces| Settings { spp, ambient_bounces, ambient_divisions: 16, ..settings.clone() };
    let cached = Settings { cache: Some(CacheSettings { accuracy: 400, rays: 48 }), ..with(8, 1) };
    let kernel = |name, beyond, frame: &Frame, settings: &Settings, every: usize| {
        let tracer = Tracer::new(frame, settings);
        // Only the `records` kernel has records to fill.
        tracer.fill(&|_, _| (), &AtomicBool::new(false));
        let pixels = (0..SIZE * SIZE).step_by(every).collect();
        Kernel { name, beyond, does: Does::Trace(Box::new(tracer), pixels) }
    };
    let room = room();
    vec![
        kernel("coherent", 1.10, &room, &with(4, 0), 1),
        kernel(REFERENCE, 1.085, &room, &with(1, 1), 1),
        kernel("traversal", 1.26, &interior(FEW), &with(1, 1), 3),
        kernel("memory", 1.41, &interior(MANY), &with(1, 1), 3),
        kernel("lights", 1.18, &lit_floor(), &with(8, 0), 1),
        kernel("surfaces", 0.78, &dark_floor(), &with(16, 0), 1),
        kernel("texture", 1.16, &sheets(), &with(1, 0), 1),
        kernel("records", 1.03, &room, &cached, 1),
        Kernel { name: "build", beyond: 0.53, does: Does::Build(Box::new(hills(BUILT)), settings.clone()) },
    ]
}

/// A scene under construction. Each object has a stratum of its own.
#[derive(Default)]
struct Builder {
    geometry: Geometry,
    materials: Vec<Material>,
    textures: Vec<Texture>,
}

impl Builder {
    /// Adds a material and an object of it.
    fn object(&mut self, name: &str, surface: Surface, emission: f32) -> u32 {
        let stratum = self.materials.len() as u32;
        self.materials.push(Material {
            name: name.into(),
            surface,
            emission: Color::plain(Vec3::splat(emission)),
            emits_both_sides: false,
            opacity: 1.0,
            mask: None,
        });
        let Strata { objects, pairs } = &mut self.geometry.strata;
        objects.push(name.to_owned());
        pairs.push((stratum, stratum));
        stratum
    }

    /// Seen from 8.5 m in front and 4.5 m above.
    fn frame(self) -> Frame {
        let forward = Vec3::new(0.0, -0.5, -1.0).normalize();
        Frame {
            number: 0,
            camera: Camera {
                origin: Vec3::new(0.0, 4.5, 8.5),
                right: Vec3::X,
                up: Vec3::X.cross(forward),
                forward,
                tan_half_x: 0.5,
                tan_half_y: 0.5,
                width: SIZE,
                height: SIZE,
                aperture_radius: 0.0,
                focus_distance: 1.0,
            },
            geometry: Arc::new(self.geometry),
            materials: self.materials.into(),
            textures: self.textures.into(),
            points: Vec::new(),
            suns: Vec::new(),
            environment: Environment::Constant(Vec3::splat(0.2)),
        }
    }
}

fn matt(albedo: f32) -> Surface {
    Surface::Lambert { albedo: Color::plain(Vec3::splat(albedo)) }
}

/// A square facing up, `half` metres to each side.
fn square(half: f32, height: f32) -> [Vec3; 4] {
    [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(x, z)| Vec3::new(half * x, height, half * z))
}

/// The same, facing down.
fn lamp(half: f32, height: f32) -> [Vec3; 4] {
    let mut corners = square(half, height);
    corners.reverse();
    corners
}

/// A floor, a light above it, and boxes of irregular heights.
fn room() -> Frame {
    let mut scene = Builder::default();
    let ground = scene.object("floor", matt(0.6), 0.0);
    let light = scene.object("light", matt(0.0), 12.0);
    let boxes = [
        scene.object("matt", matt(0.5), 0.0),
        scene.object("mirror", Surface::Metal { f0: Color::plain(Vec3::splat(0.9)), alpha: 0.0 }, 0.0),
        scene.object(
            "glass",
            Surface::Glass { ior: 1.5, transmittance: Color::plain(Vec3::ONE), alpha: 0.0, priority: None },
            0.0,
        ),
    ];
    quad(&mut scene.geometry, square(6.0, 0.0), ground);
    quad(&mut scene.geometry, lamp(1.0, 5.0), light);
    for i in 0..BOXES * BOXES {
        let at = |place: u32| 8.0 * ((place as f32 + 0.5) / BOXES as f32 - 0.5);
        let base = Vec3::new(at(i % BOXES), 0.0, at(i / BOXES));
        let height = 0.2 + 0.1 * (i * 29 % 17) as f32;
        cuboid(&mut scene.geometry, base, Vec3::new(0.12, height, 0.12), boxes[(i * 13 % 5 % 3) as usize]);
    }
    scene.frame()
}

/// A closed room around the camera, with three lamps under its ceiling and balls.
fn interior(rings: u32) -> Frame {
    const HALF: f32 = 10.0;
    const HEIGHT: f32 = 7.0;
    let mut scene = Builder::default();
    let plastic = Surface::Plastic { albedo: Color::plain(Vec3::splat(0.4)), ior: 1.5, alpha: 0.3 };
    let walls = scene.object("walls", matt(0.6), 0.0);
    let light = scene.object("lights", matt(0.0), 12.0);
    let balls = [scene.object("matt", matt(0.5), 0.0), scene.object("plastic", plastic, 0.0)];
    let geometry = &mut scene.geometry;
    quad(geometry, square(HALF, 0.0), walls);
    quad(geometry, lamp(HALF, HEIGHT), walls);
    for (across, along) in
        [(Vec3::X, Vec3::Z), (Vec3::NEG_X, Vec3::NEG_Z), (Vec3::Z, Vec3::NEG_X), (Vec3::NEG_Z, Vec3::X)]
    {
        let corner = |x: f32, y: f32| HALF * (x * across - along) + Vec3::new(0.0, y, 0.0);
        quad(
            geometry,
            [corner(-1.0, 0.0), corner(1.0, 0.0), corner(1.0, HEIGHT), corner(-1.0, HEIGHT)],
            walls,
        );
    }
    for (i, half) in [(-1.0, 0.3), (0.0, 1.0), (1.0, 0.6)] {
        let corners = lamp(half, HEIGHT - 0.1).map(|corner| corner + Vec3::new(5.0 * i, 0.0, -2.0 * i));
        quad(geometry, corners, light);
    }
    for i in 0..BALLS {
        let place = |factor: u32| (i * factor % BALLS) as f32 / BALLS as f32;
        let radius = 0.3 + 0.4 * place(29);
        let centre = Vec3::new(16.0 * (place(75) - 0.5), radius + 5.0 * place(117), 14.0 * place(1) - 9.0);
        ball(geometry, centre, radius, rings, balls[(i % 2) as usize]);
    }
    Frame { environment: Environment::Constant(Vec3::ZERO), ..scene.frame() }
}

/// A ball of rings, each of twice as many squares.
fn ball(geometry: &mut Geometry, centre: Vec3, radius: f32, rings: u32, stratum: u32) {
    let around = 2 * rings;
    let first = geometry.positions.len() as u32;
    for i in 0..(rings + 1) * around {
        let (down, turn) = (i / around, i % around);
        let (latitude, longitude) = (
            std::f32::consts::PI * down as f32 / rings as f32,
            std::f32::consts::TAU * turn as f32 / around as f32,
        );
        let (sine, cosine) = (libm::sinf(latitude), libm::cosf(latitude));
        let outward = Vec3::new(sine * libm::cosf(longitude), cosine, sine * libm::sinf(longitude));
        geometry.positions.push(centre + radius * outward);
        geometry.normals.push(Vec3::ZERO);
        geometry.uvs.push(Vec2::ZERO);
    }
    for i in 0..rings * around {
        let (down, turn) = (i / around, i % around);
        let corner = |down: u32, turn: u32| first + down * around + turn % around;
        let [a, b, c, d] =
            [corner(down, turn), corner(down, turn + 1), corner(down + 1, turn + 1), corner(down + 1, turn)];
        // At the poles a square has three corners.
        geometry.triangles.extend((down > 0).then_some([a, b, c]));
        geometry.triangles.extend((down < rings - 1).then_some([a, c, d]));
    }
    geometry.triangle_stratum.resize(geometry.triangles.len(), stratum);
}

/// Ground of irregular height.
fn hills(squares: u32) -> Frame {
    let mut scene = Builder::default();
    let ground = scene.object("hills", matt(0.6), 0.0);
    let geometry = &mut scene.geometry;
    let side = squares + 1;
    for i in 0..side * side {
        let (column, row) = (i % side, i / side);
        let at = |place: u32| 12.0 * (place as f32 / squares as f32 - 0.5);
        // The high bits of a product with the golden ratio.
        let height = (i.wrapping_mul(2_654_435_769) >> 22) as f32 / 1024.0;
        geometry.positions.push(Vec3::new(at(column), 0.3 * height, at(row)));
        geometry.normals.push(Vec3::ZERO);
        geometry.uvs.push(Vec2::ZERO);
    }
    for i in 0..squares * squares {
        let first = i / squares * side + i % squares;
        let [a, b, c, d] = [first, first + side, first + side + 1, first + 1];
        geometry.triangles.extend([[a, b, c], [a, c, d]]);
        geometry.triangle_stratum.extend([ground; 2]);
    }
    scene.frame()
}

fn lit_floor() -> Frame {
    let mut scene = Builder::default();
    let plastic = Surface::Plastic { albedo: Color::plain(Vec3::splat(0.4)), ior: 1.5, alpha: 0.3 };
    let ground = scene.object("floor", plastic, 0.0);
    let light = scene.object("light", matt(0.0), 12.0);
    quad(&mut scene.geometry, square(9.0, 0.0), ground);
    quad(&mut scene.geometry, lamp(1.0, 5.0), light);
    scene.frame()
}

fn dark_floor() -> Frame {
    let mut scene = Builder::default();
    let ground = scene.object("floor", matt(0.6), 0.0);
    quad(&mut scene.geometry, square(9.0, 0.0), ground);
    Frame { environment: Environment::Constant(Vec3::ZERO), ..scene.frame() }
}

/// A floor under sheets that their image cuts out entirely.
fn sheets() -> Frame {
    let mut scene = Builder::default();
    let ground = scene.object("floor", matt(0.6), 0.0);
    let sheet = scene.object("sheets", matt(0.6), 0.0);
    scene.materials[sheet as usize].mask = Some(AlphaMask { texture: TextureId(0), cutoff: 0.5 });
    scene.textures.push(Texture {
        name: "sheets".into(),
        width: TEXELS,
        height: TEXELS,
        texels: Texels::Srgb8(vec![[90, 120, 60, 0]; (TEXELS * TEXELS) as usize]),
    });
    quad(&mut scene.geometry, square(9.0, 0.0), ground);
    for i in 1..=SHEETS {
        quad(&mut scene.geometry, square(9.0, 0.1 * i as f32), sheet);
    }
    scene.frame()
}

/// A box on the ground, with half widths `half.x` and `half.z`, and height `half.y`.
fn cuboid(geometry: &mut Geometry, base: Vec3, half: Vec3, stratum: u32) {
    let corner = |i: u32| {
        let side = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let up = if i >> 1 & 1 == 1 { half.y } else { 0.01 };
        base + Vec3::new(half.x * side(0), up, half.z * side(2))
    };
    for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
        quad(geometry, face.map(corner), stratum);
    }
}

/// Two triangles, counter-clockwise seen from the front.
fn quad(geometry: &mut Geometry, corners: [Vec3; 4], stratum: u32) {
    let first = geometry.positions.len() as u32;
    geometry.positions.extend(corners);
    geometry.normals.extend([Vec3::ZERO; 4]);
    geometry.uvs.extend([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
    geometry.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    geometry.triangle_stratum.extend([stratum; 2]);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How far a triangle faces away from a point. Negative if it faces towards it.
    fn away(geometry: &Geometry, triangle: u32, from: Vec3) -> f32 {
        let [a, b, c] = geometry.corners(triangle);
        geometry.geometric_normal(triangle).dot(((a + b + c) / 3.0 - from).normalize())
    }

    #[test]
    fn boxes_and_balls_face_outwards_and_hills_upwards() {
        let frame = room();
        let geometry = &frame.geometry;
        for triangle in 4..geometry.triangles.len() as u32 {
            let first = 8 + (triangle - 4) / 12 * 24;
            let own = &geometry.positions[first as usize..first as usize + 24];
            let centre = own.iter().sum::<Vec3>() / 24.0;
            assert!(away(geometry, triangle, centre) > 0.0, "triangle {triangle}");
        }
        let hills = hills(BUILT);
        assert_eq!(hills.geometry.triangles.len(), 51_200);
        assert!((0..51_200).step_by(109).all(|triangle| hills.geometry.geometric_normal(triangle).y > 0.0));
    }

    #[test]
    fn the_closed_room_faces_the_camera_and_its_balls_face_outwards() {
        const ROOM: u32 = 18;
        for (rings, triangles) in [(FEW, 6162), (MANY, 518_162)] {
            let frame = interior(rings);
            let geometry = &frame.geometry;
            assert_eq!(geometry.triangles.len(), triangles);
            assert_eq!(geometry.triangle_stratum.len(), triangles);
            assert!((0..ROOM).all(|triangle| away(geometry, triangle, frame.camera.origin) < 0.0));
            let (corners, of_ball) = (((rings + 1) * 2 * rings) as usize, 4 * rings * (rings - 1));
            for triangle in (ROOM..triangles as u32).step_by(if rings == FEW { 1 } else { 997 }) {
                let first = 36 + (triangle - ROOM) as usize / of_ball as usize * corners;
                let own = &geometry.positions[first..first + corners];
                let centre = own.iter().sum::<Vec3>() / corners as f32;
                assert!(away(geometry, triangle, centre) > 0.9, "triangle {triangle} of {rings} rings");
            }
        }
    }
}
