//! What is said to be out of reach is met by no path: random closed surfaces, random things inside, outside
//! and across them, and many random paths from the camera. What lies clearly on the other side is found.

mod support;

use forelight_bvh::{Bvh, Ray, Traversal, offset_origin, size_of};
use forelight_scene::{Environment, Frame};
use forelight_tracer::reachable;
use glam::{Quat, Vec3};
use std::sync::Arc;
use support::{Builder, lambert, material};

/// Numbers in [0, 1) from a counter (PCG's output function).
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        (((word >> 22) ^ word) >> 8) as f32 / (1 << 24) as f32
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let p = 2.0 * Vec3::new(self.next(), self.next(), self.next()) - 1.0;
            if p.length_squared() < 1.0 && p.length_squared() > 0.01 {
                return p.normalize();
            }
        }
    }

    fn rotation(&mut self) -> Quat {
        Quat::from_axis_angle(self.direction(), std::f32::consts::TAU * self.next())
    }
}

/// A scene about one random shell with radii 1 to 2: a cube with divided sides, pushed in and out.
struct Case {
    frame: Frame,
    /// Each small object's name, and whether it is beyond the shell from the camera (`None`: it crosses or is
    /// close).
    small: Vec<(String, Option<bool>)>,
}

const INNER: f32 = 1.0;
const OUTER: f32 = 2.0;

fn case(seed: u32) -> Case {
    let mut n = Numbers(seed);
    let inside = seed.is_multiple_of(2);
    let closed = seed % 5 != 4;
    let place = 10.0 * n.direction() * n.next();
    let mut builder = Builder::default();
    let mut small = Vec::new();
    builder = builder.cuboid(Vec3::splat(-1.0), Vec3::ONE, false, material("shell", lambert(0.5), 0.0));
    let mut shapes: Vec<(Vec3, Quat)> = Vec::new();
    for i in 0..12 {
        // Equal sizes, so none holds another: inside the inner sphere, outside the outer, a few in between.
        let (distance, beyond) = match i % 6 {
            0 | 2 | 4 => (0.4 + 0.4 * n.next(), Some(!inside)),
            1 | 3 => (OUTER + 0.2 + 0.4 * n.next(), Some(inside)),
            _ => (INNER + (OUTER - INNER) * n.next(), None),
        };
        let name = format!("small {i}");
        builder = builder.cuboid(Vec3::splat(-1.0), Vec3::ONE, false, material(&name, lambert(0.5), 0.0));
        shapes.push((n.direction() * distance, n.rotation()));
        small.push((name, beyond));
    }
    let eye = if inside { 0.2 * n.direction() } else { (OUTER + 1.0) * n.direction() };
    let mut frame = builder.frame(place + eye, place, 16, Environment::Constant(Vec3::ONE));
    let geometry = Arc::make_mut(&mut frame.geometry);
    // The boxes, moved to their places; none holds the camera.
    for (i, &(centre, rotation)) in shapes.iter().enumerate() {
        for p in &mut geometry.positions[24 * (i + 1)..24 * (i + 2)] {
            *p = place + centre + rotation * (0.1 * *p);
        }
    }
    // The shell: a divided cube, every corner at a radius that depends only on its position.
    let cube: Vec<[Vec3; 3]> = (0..12).map(|t| geometry.corners(t)).collect();
    let mut pieces = Vec::new();
    for corners in cube {
        divide(corners, 2, &mut pieces);
    }
    let bumps: Vec<(Vec3, f32)> = (0..6).map(|_| (n.direction(), n.next() - 0.5)).collect();
    let pushed = |p: Vec3| {
        let d = p.normalize();
        let bump: f32 = bumps.iter().map(|(towards, by)| by * d.dot(*towards).max(0.0)).sum();
        place + d * (1.5 + 0.8 * bump).clamp(1.3, 1.9)
    };
    let first = if closed { 0 } else { 1 };
    for corners in pieces.into_iter().skip(first) {
        let start = geometry.positions.len() as u32;
        for p in corners {
            geometry.positions.push(pushed(p));
            geometry.normals.push(Vec3::ZERO);
            geometry.uvs.push(glam::Vec2::ZERO);
        }
        geometry.triangles.push([start, start + 1, start + 2]);
        geometry.triangle_stratum.push(0);
    }
    geometry.triangles.drain(..12);
    geometry.triangle_stratum.drain(..12);
    if !closed {
        small.iter_mut().for_each(|s| s.1 = Some(false));
    }
    Case { frame, small }
}

fn divide([a, b, c]: [Vec3; 3], depth: u32, out: &mut Vec<[Vec3; 3]>) {
    if depth == 0 {
        return out.push([a, b, c]);
    }
    // The midpoint of an edge has the same bits from both sides: addition commutes.
    let (ab, bc, ca) = ((a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5);
    for part in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
        divide(part, depth - 1, out);
    }
}

#[test]
fn no_path_meets_what_is_said_to_be_out_of_reach() {
    let (mut relied_on, mut hidden, mut met) = (0, 0, 0);
    for seed in 0..60 {
        let Case { frame, small } = case(seed);
        let reach = reachable(&frame, &frame.materials);
        let geometry = &frame.geometry;
        let found = |name: &str| {
            let mine = |t: &u32| geometry.strata.objects[geometry.object(*t) as usize] == name;
            !(0..geometry.triangles.len() as u32).filter(mine).any(|t| reach.triangle(t))
        };
        if reach.hides_triangles() {
            relied_on += 1;
            for (name, beyond) in &small {
                hidden += usize::from(found(name));
                if let Some(beyond) = beyond {
                    assert_eq!(found(name), *beyond, "{name} in case {seed}");
                }
            }
        }
        let bvh = Bvh::build(&geometry.positions, &geometry.triangles);
        let mut n = Numbers(1000 + seed);
        for _ in 0..400 {
            let mut ray = Ray::new(frame.camera.origin, n.direction());
            for _ in 0..8 {
                let Some(hit) = bvh.closest(&ray, |_| true, &mut Traversal::default()) else {
                    assert!(reach.environment(), "the sky seen in case {seed}");
                    break;
                };
                met += 1;
                assert!(reach.triangle(hit.primitive), "triangle {} in case {seed}", hit.primitive);
                let normal = geometry.geometric_normal(hit.primitive);
                let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
                let direction = n.direction();
                let direction = if direction.dot(normal) < 0.0 { -direction } else { direction };
                let corners = geometry.corners(hit.primitive);
                let origin = offset_origin(hit.position(corners), normal, size_of(corners));
                ray = Ray::new(origin, direction);
            }
        }
    }
    println!("{relied_on} shells relied on, {hidden} objects left out, {met} points met");
    assert!(relied_on > 15 && hidden > 60 && met > 50_000, "{relied_on}, {hidden}, {met}");
}

#[test]
fn an_open_shell_hides_nothing() {
    for seed in (4..60).step_by(5) {
        let Case { frame, .. } = case(seed);
        assert!(!reachable(&frame, &frame.materials).hides_triangles(), "case {seed}");
    }
}
