//! The tree alone: closed meshes without cracks, degenerate triangles, rays along axes and through corners,
//! coplanar surfaces.

use forelight_bvh::{Bvh, Hit, Ray, Traversal};
use forelight_random::Random;
use forelight_tests::case::case;
use forelight_tests::world::{cuboid, icosphere};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Random numbers.
#[derive(Clone)]
pub struct Stream(Random);

impl Stream {
    pub fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    /// In [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0.uniform()
    }

    /// Below `bound`.
    pub fn below(&mut self, bound: usize) -> usize {
        self.0.index(bound)
    }

    /// In the cube of side 2 about the origin.
    pub fn point(&mut self) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|_| (2.0 * self.uniform() - 1.0) as f32))
    }
}

struct Mesh {
    name: String,
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    /// Origins are within this distance of the centre, by axis.
    inside: Vec3,
}

impl Mesh {
    fn new(name: String, positions: &[DVec3], triangles: Vec<[u32; 3]>, inside: Vec3) -> Self {
        Self { name, positions: positions.iter().map(|p| p.as_vec3()).collect(), triangles, inside }
    }
}

/// Two cones over a polygon with many corners: long thin fans that meet in two tips.
fn fans(corners: u32, height: f64) -> Mesh {
    let mut positions = vec![DVec3::new(0.0, height, 0.0), DVec3::new(0.0, -height, 0.0)];
    positions.extend((0..corners).map(|i| {
        let (s, c) = (f64::from(i) / f64::from(corners) * std::f64::consts::TAU).sin_cos();
        DVec3::new(c, 0.0, s)
    }));
    let triangles = (0..corners).flat_map(|i| {
        let (a, b) = (2 + i, 2 + (i + 1) % corners);
        [[0, b, a], [1, a, b]]
    });
    let triangles = triangles.collect();
    Mesh::new(format!("fans of {corners}"), &positions, triangles, Vec3::splat(0.2))
}

/// A box whose faces are grids, with inner vertices moved out and in.
fn rough_box(n: u32) -> Mesh {
    let mut stream = Stream::new(3);
    let mut positions = Vec::new();
    let mut known = std::collections::BTreeMap::new();
    let mut triangles = Vec::new();
    let mut vertex = |p: [u32; 3]| {
        *known.entry(p).or_insert_with(|| {
            let unit =
                DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])) / f64::from(n) * 2.0 - 1.0;
            positions.push(unit * (1.0 + 0.02 * stream.uniform()));
            positions.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        for side in [0, n] {
            for i in 0..n {
                for j in 0..n {
                    let mut at = |i: u32, j: u32| {
                        let mut p = [0; 3];
                        (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (side, i, j);
                        vertex(p)
                    };
                    let q = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                    triangles.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
                }
            }
        }
    }
    Mesh::new(format!("box of grids {n}"), &positions, triangles, Vec3::splat(0.5))
}

fn closed_meshes() -> Vec<Mesh> {
    let mut meshes: Vec<Mesh> = (0..8)
        .map(|level| {
            let (positions, triangles) = icosphere(level);
            Mesh::new(format!("icosphere {level}"), &positions, triangles, Vec3::splat(0.3))
        })
        .collect();
    let (positions, triangles) = cuboid(DVec3::splat(-1.0), DVec3::ONE, false);
    meshes.push(Mesh::new("box".into(), &positions, triangles, Vec3::splat(0.9)));
    // Distances along a ray are known to 6e-8 of the triangle's size. A wall must be farther away than that.
    let (positions, triangles) = cuboid(DVec3::new(-1.0, -1e-2, -1e2), DVec3::new(1.0, 1e-2, 1e2), false);
    meshes.push(Mesh::new("box 1 : 10² : 10⁴".into(), &positions, triangles, Vec3::new(0.9, 9e-3, 90.0)));
    meshes.extend([fans(5, 1.0), fans(10_000, 1.0), fans(1000, 1e4), rough_box(32)]);
    meshes
}

#[test]
fn no_ray_escapes_from_a_closed_mesh() {
    let wanted = std::env::var("FORELIGHT_HARD_RAYS").ok().and_then(|n| n.parse().ok());
    let rays: u64 = wanted.unwrap_or(1_000_000);
    let meshes = closed_meshes();
    let per_mesh = rays / meshes.len() as u64;
    let (mut escaped, mut shot) = (0, 0);
    for mesh in &meshes {
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles);
        let chunks = per_mesh.div_ceil(4096);
        let lost: u64 = (0..chunks)
            .into_par_iter()
            .map(|chunk| {
                let mut stream = Stream::new(chunk);
                let mut steps = Traversal::default();
                let mut lost = 0;
                for _ in 0..4096 {
                    let origin = stream.point() * mesh.inside;
                    let direction = aimed(&mut stream, mesh, origin);
                    let ray = Ray::new(origin, direction);
                    let closest = bvh.closest(&ray, |_| true, &mut steps);
                    let any = bvh.any(&ray, |_| true, &mut steps);
                    lost += u64::from(closest.is_none() || !any);
                }
                lost
            })
            .sum();
        if lost > 0 {
            println!("{}: {lost} rays of {} escaped", mesh.name, chunks * 4096);
        }
        escaped += lost;
        shot += chunks * 4096;
    }
    // None: shared edges are decided by signs alone.
    case(10, "rays at vertices, edges and along axes that escape from closed meshes").never(escaped, shot);
}

/// From inside towards a vertex, a point of an edge, slightly beside either, or along an axis.
fn aimed(stream: &mut Stream, mesh: &Mesh, origin: Vec3) -> Vec3 {
    let corners = mesh.triangles[stream.below(mesh.triangles.len())].map(|i| mesh.positions[i as usize]);
    let direction = match stream.below(6) {
        0 => corners[0] - origin,
        1 => corners[0].lerp(corners[1], stream.uniform() as f32) - origin,
        2 => {
            // The same, one or a few ulps away.
            let d = corners[0].lerp(corners[1], stream.uniform() as f32) - origin;
            let step = stream.below(7) as i32 - 3;
            let axis = stream.below(3);
            let mut d = d.to_array();
            d[axis] = f32::from_bits(d[axis].to_bits().wrapping_add_signed(step));
            Vec3::from_array(d)
        }
        3 => {
            let mut d = [0.0, -0.0, 0.0];
            d[stream.below(3)] = if stream.below(2) == 0 { 1.0 } else { -1.0 };
            Vec3::from_array(d)
        }
        // Along an edge, or anywhere.
        4 => corners[1] - corners[0],
        _ => stream.point(),
    };
    if direction.is_finite() && direction != Vec3::ZERO { direction } else { Vec3::X }
}

/// Brute force: each triangle in its own tree, so that the same test decides and no box can hide anything.
struct Loose(Vec<Bvh>);

impl Loose {
    fn new(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        // A tree of one triangle is one box, which rays may miss. Two far, tiny triangles enlarge it.
        let mut wide = positions.to_vec();
        let first = wide.len() as u32;
        for corner in [Vec3::splat(-1e6), Vec3::splat(1e6)] {
            wide.extend([corner, corner + Vec3::X, corner + Vec3::Y]);
        }
        let far = [[first, first + 1, first + 2], [first + 3, first + 4, first + 5]];
        Self(triangles.iter().map(|&t| Bvh::build(&wide, &[t, far[0], far[1]])).collect())
    }

    fn closest(&self, ray: &Ray) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        for (i, tree) in self.0.iter().enumerate() {
            let hit = tree.closest(ray, |hit| hit.primitive == 0, &mut Traversal::default());
            if let Some(hit) = hit
                && best.is_none_or(|b| hit.t < b.t)
            {
                best = Some(Hit { primitive: i as u32, ..hit });
            }
        }
        best
    }
}

/// A grid of boxes whose faces share planes, with random triangles between them.
fn lattice() -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let mut stream = Stream::new(11);
    for i in 0..4u32 {
        let low = DVec3::new(f64::from(i % 2), f64::from(i / 2), f64::from(i % 3) * 0.5) - 1.0;
        let (p, t) = cuboid(low, low + 1.0, i % 2 == 1);
        let first = positions.len() as u32;
        positions.extend(p.iter().map(|p| p.as_vec3()));
        triangles.extend(t.iter().map(|t| t.map(|i| first + i)));
    }
    for _ in 0..40 {
        let first = positions.len() as u32;
        let at = stream.point();
        positions.extend((0..3).map(|_| at + stream.point() * 0.2));
        triangles.push([first, first + 1, first + 2]);
    }
    (positions, triangles)
}

#[test]
fn rays_along_axes_and_from_box_faces_hit_what_testing_every_triangle_hits() {
    let (positions, triangles) = lattice();
    let bvh = Bvh::build(&positions, &triangles);
    let loose = Loose::new(&positions, &triangles);
    let mut stream = Stream::new(5);
    let (mut wrong, mut hits, rays) = (0, 0u64, 30_000);
    for _ in 0..rays {
        let corner = positions[stream.below(positions.len())];
        let other = positions[stream.below(positions.len())];
        // On a vertex, on the line between two, in a plane of a box, or anywhere.
        let mut origin = match stream.below(4) {
            0 => corner,
            1 => corner.lerp(other, 0.5),
            2 => stream.point().with_x(corner.x),
            _ => stream.point() * 1.5,
        };
        if stream.below(3) == 0 {
            let axis = stream.below(3);
            origin[axis] = corner[axis];
        }
        let zero = |stream: &mut Stream| if stream.below(2) == 0 { 0.0f32 } else { -0.0 };
        let mut direction = Vec3::from_array(std::array::from_fn(|_| zero(&mut stream)));
        direction[stream.below(3)] = if stream.below(2) == 0 { 1.0 } else { -1.0 };
        if stream.below(4) == 0 {
            direction[stream.below(3)] = (2.0 * stream.uniform() - 1.0) as f32;
        }
        if stream.below(8) == 0 {
            direction = other - origin;
        }
        if direction == Vec3::ZERO {
            continue;
        }
        let ray = Ray::new(origin, direction);
        let (found, expected) = (bvh.closest(&ray, |_| true, &mut Traversal::default()), loose.closest(&ray));
        let any = bvh.any(&ray, |_| true, &mut Traversal::default());
        hits += u64::from(expected.is_some());
        if found != expected || any != expected.is_some() {
            wrong += 1;
            println!("{ray:?}: {found:?} instead of {expected:?}, any: {any}");
        }
    }
    assert!(hits > rays / 4, "the boxes must be hit often enough to prove something: {hits}");
    // None: t, triangle and barycentric weights have the same bits.
    case(12, "rays along axes, from corners, edges and faces, that differ from brute force")
        .never(wrong, rays);
}

#[test]
fn degenerate_triangles_are_never_hit_and_hide_nothing() {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let (p, t) = icosphere(2);
    positions.extend(p.iter().map(|p| p.as_vec3()));
    triangles.extend(t);
    let sound = triangles.len() as u32;
    let clean = Bvh::build(&positions, &triangles);
    let mut stream = Stream::new(7);
    let mut add = |corners: [Vec3; 3]| {
        let first = positions.len() as u32;
        positions.extend(corners);
        triangles.push([first, first + 1, first + 2]);
    };
    for _ in 0..200 {
        let (a, b) = (stream.point() * 0.9, stream.point() * 0.9);
        add([a, a, a]);
        add([a, a, b]);
        add([a, b, a.midpoint(b)]);
        // Sides that are denormal, or so short that their products are.
        add([a * 1e-40, b * 1e-40, Vec3::ZERO]);
        add([a * 1e-25, b * 1e-25, a.cross(b) * 1e-25]);
    }
    let all = Bvh::build(&positions, &triangles);
    let (mut wrong, mut shot) = (0, 0u64);
    for i in 0..100_000 {
        let origin = stream.point() * 0.3;
        // Aim every third ray at a degenerate triangle.
        let target = positions[162 + stream.below(positions.len() - 162)];
        let direction = if i % 3 == 0 { target - origin } else { stream.point() };
        if direction == Vec3::ZERO {
            continue;
        }
        let ray = Ray::new(origin, direction);
        let (a, b) = (
            clean.closest(&ray, |_| true, &mut Traversal::default()),
            all.closest(&ray, |_| true, &mut Traversal::default()),
        );
        shot += 1;
        // The hit must be the sphere, at a finite distance with weights inside the triangle, or a sound hit
        // of a tiny one.
        let is_sound =
            |h: &Hit| h.t.is_finite() && h.t > 0.0 && h.u >= 0.0 && h.v >= 0.0 && h.u + h.v <= 1.0 + 1e-6;
        let ok = match (a, b) {
            (Some(a), Some(b)) => is_sound(&b) && (a == b || (b.primitive >= sound && b.t < a.t)),
            _ => false,
        };
        if !ok {
            wrong += 1;
            println!("{ray:?}: {b:?} instead of {a:?}");
        }
    }
    case(11, "rays that a thousand degenerate triangles mislead").never(wrong, shot);
}

#[test]
fn slivers_are_hit_where_they_are() {
    // Slivers of 1 : 10⁷ tile a square. A ray through it hits exactly one of them, or their common edge.
    let count = 1000u32;
    let mut positions: Vec<Vec3> = Vec::new();
    let mut triangles = Vec::new();
    for i in 0..=count {
        let x = i as f32 * 1e-7;
        positions.extend([Vec3::new(x, 0.0, 0.0), Vec3::new(x, 1.0, 0.0)]);
    }
    for i in 0..count {
        let a = 2 * i;
        triangles.extend([[a, a + 2, a + 3], [a, a + 3, a + 1]]);
    }
    let bvh = Bvh::build(&positions, &triangles);
    let mut stream = Stream::new(2);
    let width = count as f32 * 1e-7;
    let (mut missed, rays) = (0, 100_000);
    let mut furthest = 0.0f64;
    for _ in 0..rays {
        let target = Vec3::new(stream.uniform() as f32 * width * 0.999, stream.uniform() as f32, 0.0);
        let ray = Ray::new(target + Vec3::Z, Vec3::NEG_Z);
        match bvh.closest(&ray, |_| true, &mut Traversal::default()) {
            None => missed += 1,
            Some(hit) => {
                let corners = triangles[hit.primitive as usize].map(|i| positions[i as usize]);
                furthest = furthest.max(f64::from(hit.position(corners).distance(target)));
            }
        }
    }
    case(11, "rays that pass between slivers of 1 : 10⁷").never(missed, rays);
    // Weights are quotients of areas of 1e-7 with relative rounding 1e-7. Positions of size 1 follow to an
    // ulp or two.
    case(11, "distance of the point hit on a sliver from the ray").worst(furthest, 3e-7);
}

#[test]
fn of_surfaces_in_the_same_place_the_same_one_wins_whatever_the_tree() {
    // The same rectangle several times, some turned, flipped or cut along the other diagonal.
    let mut stream = Stream::new(13);
    let (mut wrong, mut rays, mut not_lowest) = (0u64, 0u64, 0u64);
    for tilted in [false, true] {
        let (u, v) = if tilted {
            (Vec3::new(0.6, 0.48, 0.64), Vec3::new(-0.8, 0.36, 0.48))
        } else {
            (Vec3::X, Vec3::Y)
        };
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for copy in 0..24usize {
            let first = positions.len() as u32;
            let corners = [-u - v, u - v, u + v, v - u];
            let turn = if copy < 12 { 0 } else { copy };
            positions.extend((0..4).map(|i| corners[(i + turn) % 4]));
            let (a, b) = ([first, first + 1, first + 2], [first, first + 2, first + 3]);
            triangles.extend(if copy % 3 == 2 { [[a[0], a[2], a[1]], [b[0], b[2], b[1]]] } else { [a, b] });
        }
        let bvh = Bvh::build(&positions, &triangles);
        let loose = Loose::new(&positions, &triangles);
        // Another tree over the same triangles, in another order.
        let order: Vec<usize> = (0..triangles.len()).map(|i| (i * 31 + 7) % triangles.len()).collect();
        let shuffled: Vec<[u32; 3]> = order.iter().map(|&i| triangles[i]).collect();
        let other = Bvh::build(&positions, &shuffled);
        for _ in 0..20_000 {
            let target =
                u * (1.8 * stream.uniform() - 0.9) as f32 + v * (1.8 * stream.uniform() - 0.9) as f32;
            let origin = stream.point() * 2.0;
            let ray = Ray::new(origin, target - origin);
            let hit = |bvh: &Bvh| bvh.closest(&ray, |_| true, &mut Traversal::default());
            let (Some(a), Some(b)) = (hit(&bvh), loose.closest(&ray)) else { continue };
            rays += 1;
            wrong += u64::from(a != b);
            // Another triangle may have the lowest number there, but t has the same bits.
            wrong += u64::from(hit(&other).is_none_or(|c| c.t != a.t));
            // The first copy contains every point. A copy cut differently wins where rounding puts it an ulp
            // nearer.
            not_lowest += u64::from(a.primitive > 1);
        }
    }
    // t is compared to the bit, and the lowest number wins a tie.
    case(13, "rays at 24 surfaces in one place whose winner depends on the tree").never(wrong, rays);
    println!("         (a later copy was nearer by rounding in {not_lowest} of {rays})");
}

#[test]
fn of_equal_surfaces_the_first_one_wins() {
    let (sphere, faces) = icosphere(2);
    let positions: Vec<Vec3> = sphere.iter().map(|p| p.as_vec3()).collect();
    let once: Vec<[u32; 3]> = faces.clone();
    let count = once.len() as u32;
    // Ten copies of the same triangles, in blocks rotated against each other.
    let copies: Vec<[u32; 3]> =
        (0..10 * count).map(|i| once[((i + i / count * 37) % count) as usize]).collect();
    let (bvh, single) = (Bvh::build(&positions, &copies), Bvh::build(&positions, &once));
    let mut stream = Stream::new(17);
    let (mut wrong, mut rays) = (0, 0);
    for _ in 0..50_000 {
        let ray = Ray::new(stream.point() * 0.3, stream.point());
        let hit = |bvh: &Bvh| bvh.closest(&ray, |_| true, &mut Traversal::default());
        rays += 1;
        wrong += u64::from(hit(&bvh) != hit(&single));
    }
    case(13, "rays at ten equal copies of a sphere that do not meet the first").never(wrong, rays);
}

#[test]
fn rays_at_the_long_edges_of_a_flat_box_do_not_slip_out() {
    // Found among a hundred million rays. The triangle test rounds by 2⁻²⁴ of the box's 200 m, which moves
    // the edge. One face's triangle takes the hit, but the ray misses its exact bounding box.
    let (positions, triangles) = cuboid(DVec3::new(-1.0, -1e-2, -1e2), DVec3::new(1.0, 1e-2, 1e2), false);
    let positions: Vec<Vec3> = positions.iter().map(|p| p.as_vec3()).collect();
    let bvh = Bvh::build(&positions, &triangles);
    let rays = [
        ([3192308096, 1007343405, 3264637212], [3209580448, 986185456, 3214127872]),
        ([1060536371, 3154619843, 3265424868], [3218817050, 3135326784, 1076728830]),
        ([3200455999, 1006843910, 3264514277], [3206444384, 990018572, 1082157776]),
    ];
    let vector = |bits: [u32; 3]| Vec3::from_array(bits.map(f32::from_bits));
    let escapes = |&(origin, direction): &([u32; 3], [u32; 3])| {
        let ray = Ray::new(vector(origin), vector(direction));
        bvh.closest(&ray, |_| true, &mut Traversal::default()).is_none()
    };
    let escaped = rays.iter().filter(|ray| escapes(ray)).count() as u64;
    case(10, "rays at the long edges of a flat box that slip out").never(escaped, 3);
}
