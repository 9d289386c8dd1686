//! Compares the tree with a test of every triangle, and the kernels with each other.

use crate::kernel::Portable;
use crate::node::{Bvh, END, GROUP, Group, LEAF};
use crate::ray::{Hit, Ray, Traversal};
use crate::traverse::{any as find_any, closest};
use crate::triangle::Shear;
use glam::{Vec3, Vec4};
use proptest::prelude::*;

/// Results of both queries for one ray, and their step counts.
type Answer = (Option<Hit>, bool, [(u64, u64); 2]);

fn portable(bvh: &Bvh, ray: &Ray) -> Answer {
    let (mut a, mut b) = (Traversal::default(), Traversal::default());
    let answer =
        (closest(bvh, Portable, ray, |_| true, &mut a), find_any(bvh, Portable, ray, |_| true, &mut b));
    (answer.0, answer.1, [(a.nodes, a.triangles), (b.nodes, b.triangles)])
}

#[cfg(target_arch = "x86_64")]
fn avx2(bvh: &Bvh, ray: &Ray) -> Option<Answer> {
    use crate::traverse::{any_avx2, closest_avx2};
    let kernel = crate::kernel::Avx2::detect()?;
    let (mut a, mut b) = (Traversal::default(), Traversal::default());
    // SAFETY: the kernel's existence proves that the processor has the features.
    let answer = unsafe {
        (closest_avx2(bvh, kernel, ray, |_| true, &mut a), any_avx2(bvh, kernel, ray, |_| true, &mut b))
    };
    Some((answer.0, answer.1, [(a.nodes, a.triangles), (b.nodes, b.triangles)]))
}

#[cfg(not(target_arch = "x86_64"))]
fn avx2(_: &Bvh, _: &Ray) -> Option<Answer> {
    None
}

/// A hit as bits, so that −0 and NaN are compared exactly.
fn bits(hit: Option<Hit>) -> Option<[u32; 4]> {
    hit.map(|h| [h.t.to_bits(), h.primitive, h.u.to_bits(), h.v.to_bits()])
}

/// The portable kernel's answer, after checking that the other kernels return the same.
fn answer(bvh: &Bvh, ray: &Ray) -> (Option<Hit>, bool) {
    let one = portable(bvh, ray);
    if let Some(other) = avx2(bvh, ray) {
        assert_eq!((bits(one.0), one.1, one.2), (bits(other.0), other.1, other.2), "{ray:?}");
    }
    (one.0, one.1)
}

/// Number of triangles that the ray meets.
fn faces_met(positions: &[Vec3], triangles: &[[u32; 3]], ray: &Ray) -> usize {
    let shear = Shear::new(ray);
    let meets = |triangle: &&[u32; 3]| {
        let corners = triangle.map(|v| positions[v as usize].to_array().map(Vec4::splat));
        let group = Group { corners, primitives: [0; GROUP] };
        shear.group(&group, f32::MAX).mask & 1 == 1
    };
    triangles.iter().filter(meets).count()
}

/// The closest hit, found by testing every triangle.
fn brute_force(positions: &[Vec3], triangles: &[[u32; 3]], ray: &Ray) -> Option<Hit> {
    let shear = Shear::new(ray);
    let mut best: Option<Hit> = None;
    for (index, triangle) in triangles.iter().enumerate() {
        let corners = triangle.map(|v| positions[v as usize].to_array().map(Vec4::splat));
        let group = Group { corners, primitives: [index as u32; GROUP] };
        let candidates = shear.group(&group, ray.t_max.min(f32::MAX));
        if candidates.mask & 1 == 1 {
            let hit = candidates.hit(&group, 0);
            if best.is_none_or(|b| hit.t < b.t) {
                best = Some(hit);
            }
        }
    }
    best
}

/// A soup of triangles and rays from a fixed seed, the same in every run.
fn soup() -> (Vec<Vec3>, Vec<[u32; 3]>, Vec<Ray>) {
    let mut state = 1u32;
    let mut next = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
        ((word >> 22) ^ word) as f32 / u32::MAX as f32 - 0.5
    };
    let mut point = |size: f32| Vec3::new(next(), next(), next()) * size;
    let mut positions = Vec::new();
    for _ in 0..500 {
        let centre = point(10.0);
        for _ in 0..3 {
            positions.push(centre + point(1.0));
        }
    }
    let triangles = (0..500).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let mut rays: Vec<Ray> = (0..2000).map(|_| Ray::new(point(12.0), point(1.0))).collect();
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            let mut direction = [0.0, -0.0, 0.0];
            direction[axis] = sign;
            rays.extend((0..200).map(|_| Ray::new(point(12.0), Vec3::from(direction))));
        }
    }
    (positions, triangles, rays)
}

#[test]
fn a_soup_is_hit_where_testing_every_triangle_hits_it() {
    let (positions, triangles, rays) = soup();
    let bvh = Bvh::build(&positions, &triangles);
    let mut hits = 0;
    for ray in &rays {
        let expected = brute_force(&positions, &triangles, ray);
        hits += usize::from(expected.is_some());
        assert_eq!(answer(&bvh, ray), (expected, expected.is_some()));
    }
    assert!(hits > rays.len() / 10, "the soup must be hit often enough to prove something: {hits}");
}

#[test]
fn every_triangle_is_in_the_tree_and_no_node_lies_deeper_than_the_tree_says() {
    let (positions, triangles, _) = soup();
    for count in [1, 2, 4, 5, 8, 9, 33, 500] {
        let bvh = Bvh::build(&positions, &triangles[..count]);
        let mut found = vec![false; count];
        let mut deepest = 0;
        let mut pending = vec![(0u32, 1)];
        while let Some((child, level)) = pending.pop() {
            if child & LEAF == 0 {
                deepest = deepest.max(level);
                let children = bvh.nodes[child as usize].children;
                pending.extend(children.iter().filter(|&&c| c != END).map(|&c| (c, level + 1)));
            } else {
                for primitive in bvh.groups[(child & !LEAF) as usize].primitives {
                    found[primitive as usize] = true;
                }
            }
        }
        assert!(found.iter().all(|&f| f), "{count} triangles");
        assert_eq!(deepest, bvh.depth);
    }
}

#[test]
fn the_tree_is_that_of_obvhs_on_one_thread_whatever_the_number_of_threads() {
    use crate::collapse::Collapse;
    use obvhs::{BvhBuildParams, bvh2::builder::build_bvh2_from_tris, triangle::Triangle};
    use std::time::Duration;
    // Equal boxes and areas, so that the order of equal elements matters; and enough of both for threads.
    let (mut positions, mut triangles) = tiled_box(24, Vec3::ZERO, Vec3::ONE);
    let radii: Vec<f32> = (0..114).map(|i| 0.4 + (i % 7) as f32 * 0.1).collect();
    let (globe, faces) = dented_globe(&radii, Vec3::splat(0.4), 1.0);
    let (soup, loose, _) = soup();
    for (more, faces) in [(globe, faces), (soup, loose)] {
        let first = positions.len() as u32;
        positions.extend(more);
        triangles.extend(faces.iter().map(|face| face.map(|v| v + first)));
    }
    let corner = |v: u32| glam::Vec3A::from(positions[v as usize]);
    let input: Vec<Triangle> =
        triangles.iter().map(|&[a, b, c]| Triangle { v0: corner(a), v1: corner(b), v2: corner(c) }).collect();
    let params = BvhBuildParams { max_prims_per_leaf: GROUP as u32, ..BvhBuildParams::slow_build() };
    let theirs = build_bvh2_from_tris(&input, params, &mut Duration::default());
    let expected = format!("{:?}", Collapse::new(&theirs, &input).run());
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let built = pool.install(|| Bvh::build(&positions, &triangles));
        assert!(format!("{built:?}") == expected, "another tree on {threads} threads");
    }
}

#[test]
fn a_tree_comes_back_from_its_bytes_and_damaged_ones_are_refused() {
    let (positions, triangles, rays) = soup();
    let tree = Bvh::build(&positions, &triangles);
    let bytes = tree.to_bytes();
    let back = Bvh::from_bytes(&bytes, triangles.len()).unwrap();
    assert_eq!(format!("{back:?}"), format!("{tree:?}"));
    assert!(Bvh::from_bytes(&bytes, triangles.len() - 1).is_none(), "a triangle that is not there");
    for length in [0, 7, 15, 16, 300, bytes.len() - 160, bytes.len() - 1] {
        assert!(Bvh::from_bytes(&bytes[..length], triangles.len()).is_none(), "{length} bytes");
    }
    let empty = Bvh::default();
    assert_eq!(Bvh::from_bytes(&empty.to_bytes(), 0).unwrap().size(), (0, 0));
    // Whatever the bytes are: what is accepted can be traversed.
    let mut random = 1u64;
    for _ in 0..2000 {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mut damaged = bytes.clone();
        let place = (random >> 33) as usize % bytes.len();
        damaged[place] ^= 1 << (random >> 61);
        if let Some(tree) = Bvh::from_bytes(&damaged, triangles.len()) {
            let ray = &rays[place % rays.len()];
            tree.closest(ray, |_| true, &mut Traversal::default());
        }
    }
}

#[test]
fn a_triangle_seen_edge_on_is_not_hit_at_infinity() {
    // The area seen along the ray is denormal, so its reciprocal is infinite.
    let positions = [Vec3::new(-4.0, 1.0, -3.0), Vec3::new(-4.0, -1.0, -3.0), Vec3::new(-4.0, 0.0, -1.0)];
    let bvh = Bvh::build(&positions, &[[0, 1, 2]]);
    let ray = Ray::new(Vec3::new(-4.0, 0.0, 0.0), Vec3::new(1e-40, -0.0, -0.5));
    assert_eq!(answer(&bvh, &ray), (None, false));
}

#[test]
fn an_empty_tree_is_never_hit() {
    let bvh = Bvh::build(&[], &[]);
    assert_eq!(answer(&bvh, &Ray::new(Vec3::ZERO, Vec3::X)), (None, false));
    assert_eq!((bvh.size(), bvh.bytes()), ((0, 0), 0));
}

#[test]
fn a_tree_as_deep_as_its_triangles_are_many_has_room_for_what_waits() {
    // Nested boxes that share a corner, with all power-of-two sizes whose squares are finite.
    let sizes = (-58..58).map(|i| (i as f32).exp2());
    let positions: Vec<Vec3> = sizes
        .flat_map(|s| [Vec3::ZERO, s * Vec3::new(1.0, 0.9, 0.1), s * Vec3::new(0.2, 1.0, 1.0)])
        .collect();
    let triangles: Vec<[u32; 3]> =
        (0..positions.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let bvh = Bvh::build(&positions, &triangles);
    for i in 0..64 {
        let target = Vec3::new(0.4, 0.6, 0.3) + 0.01 * i as f32;
        answer(&bvh, &Ray::new(Vec3::new(5.0, -3.0, 1.0), target - Vec3::new(5.0, -3.0, 1.0)));
    }
}

#[test]
fn of_triangles_at_the_same_distance_the_lowest_index_wins_wherever_it_lies_in_the_tree() {
    // Many copies of one square, with other triangles in between to spread the copies over the tree.
    let square = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for copy in 0..40u32 {
        let base = positions.len() as u32;
        positions.extend(square.map(|[x, y]| Vec3::new(x, y, 1.0)));
        triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        let base = positions.len() as u32;
        let away = 5.0 + copy as f32;
        positions.extend([Vec3::splat(away), Vec3::new(away, 0.0, 3.0), Vec3::new(0.0, away, 3.0)]);
        triangles.push([base, base + 1, base + 2]);
    }
    let bvh = Bvh::build(&positions, &triangles);
    for i in 1..200 {
        let (x, y) = (0.02 * i as f32, 4.0 - 0.019 * i as f32);
        let ray = Ray::new(Vec3::new(x, y, -1.0), Vec3::Z);
        assert_eq!(answer(&bvh, &ray).0, brute_force(&positions, &triangles, &ray));
        assert!(answer(&bvh, &ray).0.unwrap().primitive < 2);
    }
}

/// Coordinates that coincide often, so that rays meet edges, corners and the planes of boxes.
fn coarse() -> impl Strategy<Value = f32> {
    prop_oneof![8 => (-4i8..=4).prop_map(f32::from), 1 => Just(-0.0f32), 1 => -4.0f32..4.0]
}

fn coarse_point() -> impl Strategy<Value = Vec3> {
    [coarse(), coarse(), coarse()].prop_map(Vec3::from)
}

/// Directions with every kind of component: integers, zeros of either sign, denormal, huge and random.
fn direction() -> impl Strategy<Value = Vec3> {
    let component = prop_oneof![
        4 => (-3i8..=3).prop_map(f32::from),
        1 => Just(-0.0f32),
        1 => prop_oneof![Just(1e-40f32), Just(-1e-42f32), Just(1e-30f32), Just(-3e18f32)],
        3 => -1.0f32..1.0,
    ];
    [component.clone(), component.clone(), component]
        .prop_map(Vec3::from)
        .prop_filter("not zero, and with a finite inverse", |d| d.abs().max_element() >= 1e-30)
}

fn axis_parallel() -> impl Strategy<Value = Vec3> {
    let zero = || prop_oneof![Just(0.0f32), Just(-0.0f32)];
    (0..3usize, prop_oneof![Just(1.0f32), Just(-1.0f32), Just(-2.0f32)], zero(), zero()).prop_map(
        |(axis, along, a, b)| {
            let mut direction = [a, b, a];
            direction[axis] = along;
            Vec3::from(direction)
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    #[test]
    fn rays_along_the_axes_hit_exactly_what_testing_every_triangle_hits(
        positions in prop::collection::vec(coarse_point(), 3..40),
        picks in prop::collection::vec([any::<prop::sample::Index>(), any::<prop::sample::Index>(), any::<prop::sample::Index>()], 1..120),
        rays in prop::collection::vec((coarse_point(), axis_parallel()), 16),
    ) {
        // Random indices give shared edges, duplicates, and triangles degenerated to a line or a point.
        let triangles: Vec<[u32; 3]> = picks.iter().map(|p| p.map(|i| i.index(positions.len()) as u32)).collect();
        let bvh = Bvh::build(&positions, &triangles);
        for (origin, direction) in rays {
            let ray = Ray::new(origin, direction);
            let expected = brute_force(&positions, &triangles, &ray);
            prop_assert_eq!(answer(&bvh, &ray), (expected, expected.is_some()), "{:?}", ray);
        }
    }

    #[test]
    fn rays_of_any_direction_hit_what_testing_every_triangle_hits(
        positions in prop::collection::vec(coarse_point(), 3..40),
        picks in prop::collection::vec([any::<prop::sample::Index>(), any::<prop::sample::Index>(), any::<prop::sample::Index>()], 1..120),
        rays in prop::collection::vec((coarse_point(), direction(), 0.0f32..2.0, 0.5f32..20.0), 16),
    ) {
        let triangles: Vec<[u32; 3]> = picks.iter().map(|p| p.map(|i| i.index(positions.len()) as u32)).collect();
        let bvh = Bvh::build(&positions, &triangles);
        for (origin, direction, t_min, t_max) in rays {
            for ray in [Ray::new(origin, direction), Ray { origin, direction, t_min, t_max }] {
                let expected = brute_force(&positions, &triangles, &ray);
                let (found, met) = answer(&bvh, &ray);
                prop_assert_eq!(met, found.is_some(), "{:?}", ray);
                // What the tree finds is a real hit: it is not nearer than the nearest.
                let nearest = expected.map_or(f32::INFINITY, |hit| hit.t);
                prop_assert!(found.is_none_or(|hit| hit.t >= nearest), "{:?} {:?} {:?}", ray, found, expected);
                // The tree finds every hit up to rounding: at a triangle's border the box test may fail, and
                // of two triangles at nearly the same distance either may win.
                if expected.is_some_and(|hit| hit.u.min(hit.v).min(1.0 - hit.u - hit.v) > 1e-5) {
                    let far = nearest * (1.0 + 1e-5);
                    prop_assert!(found.is_some_and(|hit| hit.t <= far), "{:?} {:?} {:?}", ray, found, expected);
                }
            }
        }
    }

    #[test]
    fn a_closed_box_whose_edges_lie_in_the_planes_of_boxes_lets_no_ray_out(
        cells in 1u32..9,
        size in [0.01f32..100.0, 0.01f32..100.0, 0.01f32..100.0],
        corner in coarse_point(),
        place in [0.001f32..0.999, 0.001f32..0.999, 0.001f32..0.999],
        aims in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0u8..3, 0.0f32..1.0), 32),
    ) {
        let (positions, triangles) = tiled_box(cells, corner, Vec3::from(size));
        let bvh = Bvh::build(&positions, &triangles);
        let origin = corner + Vec3::from(place) * Vec3::from(size);
        for (triangle, corner, kind, share) in aims {
            let corners = triangles[triangle.index(triangles.len())].map(|v| positions[v as usize]);
            let [a, b] = [0, 1].map(|i| corners[(corner.index(3) + i) % 3]);
            let target = match kind {
                0 => a,
                1 => (a + b) * 0.5,
                _ => a + share * (b - a),
            };
            let ray = Ray::new(origin, target - origin);
            let (hit, met) = answer(&bvh, &ray);
            prop_assert!(hit.is_some() && met, "{:?}", ray);
            prop_assert_eq!(faces_met(&positions, &triangles, &ray), 1, "{:?}", ray);
        }
    }

    #[test]
    fn a_closed_mesh_lets_no_ray_out(
        radii in prop::collection::vec(0.5f32..2.0, 114),
        scale in -12i32..12,
        centre in coarse_point(),
        aims in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0u8..5, 0.0f32..1.0), 32),
    ) {
        let scale = (scale as f32).exp2();
        let (positions, triangles) = dented_globe(&radii, centre * scale, scale);
        let bvh = Bvh::build(&positions, &triangles);
        for (triangle, corner, kind, share) in aims {
            let corners = triangles[triangle.index(triangles.len())].map(|v| positions[v as usize]);
            let [a, b] = [0, 1].map(|i| corners[(corner.index(3) + i) % 3]);
            // The whole globe is visible from its centre.
            let origin = centre * scale;
            let direction = match kind {
                0 => a - origin,
                1 => (a + b) * 0.5 - origin,
                2 => a + share * (b - a) - origin,
                3 => { let mut d = Vec3::ZERO; d[corner.index(3)] = if share < 0.5 { -1.0 } else { 1.0 }; d }
                _ => a * 0.3 + b * 0.7 + 1e-7 * scale - origin,
            };
            let ray = Ray::new(origin, direction);
            let (hit, met) = answer(&bvh, &ray);
            prop_assert!(hit.is_some() && met, "{:?}", ray);
            prop_assert_eq!(faces_met(&positions, &triangles, &ray), 1, "{:?}", ray);
        }
    }
}

/// A globe of 8 by 16 faces, with one radius for each of its 112 inner vertices and its two poles.
fn dented_globe(radii: &[f32], centre: Vec3, scale: f32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    const RINGS: u32 = 7;
    const AROUND: u32 = 16;
    let mut positions = Vec::new();
    for ring in 0..RINGS {
        let down = std::f32::consts::PI * (ring + 1) as f32 / (RINGS + 1) as f32;
        for around in 0..AROUND {
            let turn = std::f32::consts::TAU * around as f32 / AROUND as f32;
            let direction = Vec3::new(down.sin() * turn.cos(), down.cos(), down.sin() * turn.sin());
            positions.push(centre + direction * radii[positions.len()] * scale);
        }
    }
    let (top, bottom) = (positions.len() as u32, positions.len() as u32 + 1);
    positions.push(centre + Vec3::Y * radii[112] * scale);
    positions.push(centre - Vec3::Y * radii[113] * scale);
    let vertex = |ring: u32, around: u32| ring * AROUND + around % AROUND;
    let mut triangles = Vec::new();
    for around in 0..AROUND {
        triangles.push([top, vertex(0, around), vertex(0, around + 1)]);
        for ring in 0..RINGS - 1 {
            let [a, b] = [0, 1].map(|i| vertex(ring, around + i));
            let [c, d] = [0, 1].map(|i| vertex(ring + 1, around + i));
            triangles.extend([[a, c, b], [b, c, d]]);
        }
        triangles.push([bottom, vertex(RINGS - 1, around + 1), vertex(RINGS - 1, around)]);
    }
    (positions, triangles)
}

/// A box with `cells` by `cells` squares on every side. Shared vertices are equal to the last bit.
fn tiled_box(cells: u32, corner: Vec3, size: Vec3) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let at = |steps: [u32; 3]| {
        corner + size * Vec3::from(steps.map(|s| if s == cells { 1.0 } else { s as f32 / cells as f32 }))
    };
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for side in [0, cells] {
            for (i, j) in (0..cells).flat_map(|i| (0..cells).map(move |j| (i, j))) {
                let first = positions.len() as u32;
                for (di, dj) in [(0, 0), (1, 0), (1, 1), (0, 1)] {
                    let mut steps = [side; 3];
                    steps[(axis + 1) % 3] = i + di;
                    steps[(axis + 2) % 3] = j + dj;
                    positions.push(at(steps));
                }
                triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
    }
    (positions, triangles)
}
