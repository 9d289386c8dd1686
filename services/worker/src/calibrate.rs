//! How fast this machine is.
//!
//! A node's speed is the work that one of its cores does in a second of CPU time, against a reference core that does
//! [`REFERENCE_RATE`]. It is measured by tracing pixels of a small scene that is built in code, so that every node does exactly
//! the same operations: a room with a floor, a light and a field of boxes, in matt, mirror and glass, with one ambient bounce.
//! It is traced for about [`MEASURING_TIME`]; the best of a few rounds counts, for whatever else runs on the machine only ever
//! makes it slower.

use forelight_scene::{Camera, Color, Environment, Frame, Geometry, Material, Strata, Surface};
use forelight_tracer::{Settings, Totals, Tracer};
use glam::{Vec2, Vec3};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Work units per CPU second of the reference core.
pub const REFERENCE_RATE: f64 = 1e9;
/// How long a calibration takes, roughly.
pub const MEASURING_TIME: Duration = Duration::from_millis(300);

/// Edge of the calibration image, pixels.
const SIZE: u32 = 48;

/// The speed of one core of this machine against the reference, measured now on the calling thread.
pub fn node_speed() -> f64 {
    let frame = calibration_frame();
    let settings =
        Settings { width: SIZE, height: SIZE, spp: 1, ambient_divisions: 16, ..Settings::default() };
    let tracer = Tracer::new(&frame, &settings);
    let rows: Vec<Vec<u32>> = (0..SIZE).map(|y| (y * SIZE..(y + 1) * SIZE).collect()).collect();
    let start = Instant::now();
    let mut best: f64 = 0.0;
    let mut rounds = 0;
    while rounds < 2 || start.elapsed() < MEASURING_TIME {
        // Each round is the same pixels, so that rounds, and nodes, can be compared.
        let pixels: Vec<_> = rows.iter().flat_map(|row| tracer.profile(row)).collect();
        let totals = Totals::of(pixels.iter());
        best = best.max(totals.work as f64 / (totals.cpu_nanos.max(1) as f64 * 1e-9));
        rounds += 1;
    }
    // The service takes speeds of this range; three digits are more than a measurement of this length can say.
    ((best / REFERENCE_RATE).clamp(0.001, 1000.0) * 1000.0).round() / 1000.0
}

/// The room: a floor, a light above it, and 8 × 8 boxes of heights that follow no pattern.
fn calibration_frame() -> Frame {
    let mut geometry = Geometry {
        strata: Strata {
            objects: ["floor", "light", "matt", "mirror", "glass"].map(str::to_owned).to_vec(),
            pairs: (0..5).map(|i| (i, i)).collect(),
        },
        ..Geometry::default()
    };
    let ground = [
        Vec3::new(-6.0, 0.0, 6.0),
        Vec3::new(6.0, 0.0, 6.0),
        Vec3::new(6.0, 0.0, -6.0),
        Vec3::new(-6.0, 0.0, -6.0),
    ];
    quad(&mut geometry, ground, 0);
    let lamp = [
        Vec3::new(-1.0, 5.0, -1.0),
        Vec3::new(1.0, 5.0, -1.0),
        Vec3::new(1.0, 5.0, 1.0),
        Vec3::new(-1.0, 5.0, 1.0),
    ];
    quad(&mut geometry, lamp, 1);
    for i in 0..64u32 {
        let (column, row) = (i % 8, i / 8);
        let base = Vec3::new(column as f32 - 3.5, 0.0, row as f32 - 3.5);
        let height = 0.2 + 0.1 * (i * 29 % 17) as f32;
        cuboid(&mut geometry, base, Vec3::new(0.35, height, 0.35), 2 + i * 13 % 5 % 3);
    }
    let material = |name: &str, surface: Surface, emission: f32| Material {
        name: name.into(),
        surface,
        emission: Color::plain(Vec3::splat(emission)),
        emits_both_sides: false,
        opacity: 1.0,
        mask: None,
    };
    let matt = |albedo: f32| Surface::Lambert { albedo: Color::plain(Vec3::splat(albedo)) };
    let materials = [
        material("floor", matt(0.6), 0.0),
        material("light", matt(0.0), 12.0),
        material("matt", matt(0.5), 0.0),
        material("mirror", Surface::Metal { f0: Color::plain(Vec3::splat(0.9)), alpha: 0.0 }, 0.0),
        material(
            "glass",
            Surface::Glass { ior: 1.5, transmittance: Color::plain(Vec3::ONE), alpha: 0.0 },
            0.0,
        ),
    ];
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
        geometry: Arc::new(geometry),
        materials: materials.into(),
        textures: Vec::new().into(),
        points: Vec::new(),
        suns: Vec::new(),
        environment: Environment::Constant(Vec3::splat(0.2)),
    }
}

/// A box on the ground, `half` wide to each side and `half.y` high.
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
    geometry.uvs.extend([Vec2::ZERO; 4]);
    geometry.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    geometry.triangle_stratum.extend([stratum; 2]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_boxes_face_outwards() {
        let frame = calibration_frame();
        let geometry = &frame.geometry;
        for triangle in 4..geometry.triangles.len() as u32 {
            let first = 8 + (triangle - 4) / 12 * 24;
            let own: Vec<Vec3> = geometry.positions[first as usize..first as usize + 24].to_vec();
            let centre = own.iter().sum::<Vec3>() / 24.0;
            let [a, b, c] = geometry.corners(triangle);
            let outward = geometry.geometric_normal(triangle).dot((a + b + c) / 3.0 - centre);
            assert!(outward > 0.0, "triangle {triangle}");
        }
    }

    #[test]
    fn every_calibration_does_the_same_operations() {
        let settings = Settings { width: 8, height: 8, spp: 1, ..Settings::default() };
        let work = || {
            let pixels = Tracer::new(&calibration_frame(), &settings).profile(&(0..64).collect::<Vec<_>>());
            Totals::of(pixels.iter()).work
        };
        let first = work();
        assert!(first > 64 * 1000, "the room is not empty: {first}");
        assert_eq!(first, work());
    }
}
