//! Shapes: boxes, solids of revolution, tubes and surfaces. All face outwards.

use glam::{DVec2, DVec3, dvec2, dvec3};

use super::mesh::{Axis, Mesh, sine_cosine};

/// Cosine of 41°: profile corners of a solid of revolution that turn by more stay sharp.
const CREASE_COSINE: f64 = 0.75;

/// A parallelogram that faces `edge_u × edge_v`. The texture covers it once, with u along `edge_u`.
pub fn quad(corner: DVec3, edge_u: DVec3, edge_v: DVec3) -> Mesh {
    let mut mesh = Mesh::default();
    mesh.flat_patch([corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v]);
    mesh
}

/// A sharp-edged box with corners `low` and `high`.
pub fn cuboid(low: [f64; 3], high: [f64; 3]) -> Mesh {
    rounded_cuboid(low, high, 0.0, 0)
}

/// A box with edges and corners rounded by `radius`, with `steps` facets per 45°.
pub fn rounded_cuboid(low: [f64; 3], high: [f64; 3], radius: f64, steps: usize) -> Mesh {
    let low = DVec3::from_array(low);
    let high = DVec3::from_array(high);
    let core = [low + radius, high - radius];
    // Grid lines across a face: their end of the core, and how far their normal leans outwards.
    let lean = |step: usize| {
        if steps == 0 { 0.0 } else { libm::tan((45.0 * step as f64 / steps as f64).to_radians()) }
    };
    let lines: Vec<(usize, f64)> =
        (0..=steps).rev().map(|i| (0, -lean(i))).chain((0..=steps).map(|i| (1, lean(i)))).collect();
    let mut mesh = Mesh::default();
    for face in 0..3 {
        let (u, v) = ((face + 1) % 3, (face + 2) % 3);
        for side in 0..2 {
            let first = mesh.vertices.len();
            for &(end_u, lean_u) in &lines {
                for &(end_v, lean_v) in &lines {
                    let mut normal = DVec3::ZERO;
                    normal[face] = if side == 1 { 1.0 } else { -1.0 };
                    normal[u] = lean_u;
                    normal[v] = lean_v;
                    let normal = normal.normalize();
                    let mut position = DVec3::ZERO;
                    position[face] = core[side][face];
                    position[u] = core[end_u][u];
                    position[v] = core[end_v][v];
                    let position = position + normal * radius;
                    let span = high - low;
                    let uv = dvec2((position[u] - low[u]) / span[u], (position[v] - low[v]) / span[v]);
                    mesh.vertex(position, normal, uv);
                }
            }
            let index = |i: usize, j: usize| first + i * lines.len() + j;
            for i in 0..lines.len() - 1 {
                for j in 0..lines.len() - 1 {
                    let corners = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
                    let [a, b, c, d] = corners;
                    mesh.patch(if side == 1 { corners } else { [a, d, c, b] });
                }
            }
        }
    }
    mesh
}

/// A box with a rectangular hole from top to bottom. The hole is given in x and z.
pub fn slab_with_hole(low: [f64; 3], high: [f64; 3], hole_low: [f64; 2], hole_high: [f64; 2]) -> Mesh {
    // Seen from above, with x to the right and z down, both rings run counter-clockwise.
    let ring = |x0: f64, x1: f64, z0: f64, z1: f64| [(x0, z1), (x1, z1), (x1, z0), (x0, z0)];
    let outer = ring(low[0], high[0], low[2], high[2]);
    let inner = ring(hole_low[0], hole_high[0], hole_low[1], hole_high[1]);
    let point = |(x, z): (f64, f64), y: f64| dvec3(x, y, z);
    let mut mesh = Mesh::default();
    for i in 0..4 {
        let j = (i + 1) % 4;
        let (bottom, top) = (low[1], high[1]);
        mesh.flat_patch([
            point(outer[i], top),
            point(outer[j], top),
            point(inner[j], top),
            point(inner[i], top),
        ]);
        mesh.flat_patch([
            point(outer[j], bottom),
            point(outer[i], bottom),
            point(inner[i], bottom),
            point(inner[j], bottom),
        ]);
        mesh.flat_patch([
            point(outer[i], bottom),
            point(outer[j], bottom),
            point(outer[j], top),
            point(outer[i], top),
        ]);
        mesh.flat_patch([
            point(inner[j], bottom),
            point(inner[i], bottom),
            point(inner[i], top),
            point(inner[j], top),
        ]);
    }
    mesh
}

/// An upright plate in the xy-plane with a rectangular hole. Its front is at z = 0 and faces +z.
pub fn frame(low: [f64; 2], high: [f64; 2], hole_low: [f64; 2], hole_high: [f64; 2], depth: f64) -> Mesh {
    slab_with_hole(
        [low[0], -depth, -high[1]],
        [high[0], 0.0, -low[1]],
        [hole_low[0], -hole_high[1]],
        [hole_high[0], -hole_low[1]],
    )
    .turned(Axis::X, 90.0)
}

/// A solid of revolution about the y axis. Profile points are (radius, height), with the solid on the left.
/// Corners sharper than about 41° stay sharp.
pub fn turned_body(profile: &[(f64, f64)], segments: usize) -> Mesh {
    let points: Vec<DVec2> = profile.iter().map(|&(r, y)| dvec2(r, y)).collect();
    let sides: Vec<DVec2> = points.windows(2).map(|pair| (pair[1] - pair[0]).normalize()).collect();
    let outward = |side: DVec2| dvec2(side.y, -side.x);
    let length: f64 = points.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let mut mesh = Mesh::default();
    let mut travelled = 0.0;
    for (i, &side) in sides.iter().enumerate() {
        let own = outward(side);
        let shared = |neighbour: Option<&DVec2>, end: DVec2| {
            if end.x == 0.0 {
                return dvec2(0.0, if own.y < 0.0 { -1.0 } else { 1.0 });
            }
            match neighbour.map(|&other| outward(other)) {
                Some(other) if own.dot(other) > CREASE_COSINE => (own + other).normalize(),
                _ => own,
            }
        };
        let pole_is_sharp = own.y.abs() < 0.5;
        let normal_at = |neighbour: Option<&DVec2>, end: DVec2| {
            if end.x == 0.0 && pole_is_sharp { own } else { shared(neighbour, end) }
        };
        let before = normal_at(i.checked_sub(1).and_then(|b| sides.get(b)), points[i]);
        let after = normal_at(sides.get(i + 1), points[i + 1]);
        let v = [travelled / length, (travelled + points[i].distance(points[i + 1])) / length];
        travelled += points[i].distance(points[i + 1]);
        let ring = |mesh: &mut Mesh, point: DVec2, normal: DVec2, v: f64| -> Vec<usize> {
            (0..=segments)
                .map(|j| {
                    let (sin, cos) = sine_cosine(360.0 * (j % segments) as f64 / segments as f64);
                    mesh.vertex(
                        dvec3(point.x * cos, point.y, point.x * sin),
                        dvec3(normal.x * cos, normal.y, normal.x * sin),
                        dvec2(1.0 - j as f64 / segments as f64, v),
                    )
                })
                .collect()
        };
        let low = ring(&mut mesh, points[i], before, v[0]);
        let high = ring(&mut mesh, points[i + 1], after, v[1]);
        for j in 0..segments {
            if points[i].x > 0.0 {
                mesh.triangles.push([low[j], high[j + 1], low[j + 1]]);
            }
            if points[i + 1].x > 0.0 {
                mesh.triangles.push([low[j], high[j], high[j + 1]]);
            }
        }
    }
    mesh
}

/// An upright cylinder on y = 0. Its rims are bevelled by `rim`.
pub fn cylinder(radius: f64, height: f64, rim: f64, segments: usize) -> Mesh {
    turned_body(
        &[
            (0.0, 0.0),
            (radius - rim, 0.0),
            (radius, rim),
            (radius, height - rim),
            (radius - rim, height),
            (0.0, height),
        ],
        segments,
    )
}

/// A sphere about the origin. `segments` is the number of facets around it.
pub fn sphere(radius: f64, segments: usize) -> Mesh {
    let rings = segments / 2;
    let profile: Vec<(f64, f64)> = (0..=rings)
        .map(|i| {
            let (sin, cos) = sine_cosine(180.0 * i as f64 / rings as f64);
            (if i == 0 || i == rings { 0.0 } else { radius * sin }, -radius * cos)
        })
        .collect();
    turned_body(&profile, segments)
}

/// A round tube along a path, with flat ends. The path's corners should be rounded (see [`rounded_path`]).
pub fn tube(path: &[DVec3], radius: f64, sides: usize) -> Mesh {
    let last = path.len() - 1;
    let tangent = |i: usize| (path[(i + 1).min(last)] - path[i.saturating_sub(1)]).normalize();
    let mut mesh = Mesh::default();
    let mut across = tangent(0).any_orthonormal_vector();
    let mut rings: Vec<Vec<usize>> = Vec::new();
    for (i, &centre) in path.iter().enumerate() {
        let along = tangent(i);
        // Carry the frame along the path without twist.
        across = (across - along * across.dot(along)).normalize();
        let other = along.cross(across);
        let spoke = |j: usize| {
            let (sin, cos) = sine_cosine(360.0 * (j % sides) as f64 / sides as f64);
            across * cos + other * sin
        };
        let uv = |j: usize| dvec2(j as f64 / sides as f64, i as f64 / last as f64);
        if i == 0 || i == last {
            let facing = if i == 0 { -along } else { along };
            let middle = mesh.vertex(centre, facing, uv(0));
            let rim: Vec<usize> =
                (0..sides).map(|j| mesh.vertex(centre + spoke(j) * radius, facing, uv(j))).collect();
            for j in 0..sides {
                let (a, b) = (rim[j], rim[(j + 1) % sides]);
                mesh.triangles.push(if i == 0 { [middle, b, a] } else { [middle, a, b] });
            }
        }
        rings.push((0..=sides).map(|j| mesh.vertex(centre + spoke(j) * radius, spoke(j), uv(j))).collect());
    }
    for pair in rings.windows(2) {
        for j in 0..sides {
            mesh.patch([pair[0][j], pair[0][j + 1], pair[1][j + 1], pair[1][j]]);
        }
    }
    mesh
}

/// A path through `points` with inner corners replaced by Bézier curves that start `radius` before them.
pub fn rounded_path(points: &[DVec3], radius: f64, steps: usize) -> Vec<DVec3> {
    let mut path = vec![points[0]];
    for corner in points.windows(3) {
        let from = corner[1] + (corner[0] - corner[1]).normalize() * radius;
        let to = corner[1] + (corner[2] - corner[1]).normalize() * radius;
        for step in 0..=steps {
            let t = step as f64 / steps as f64;
            path.push(from * (1.0 - t) * (1.0 - t) + corner[1] * 2.0 * t * (1.0 - t) + to * t * t);
        }
    }
    path.extend(points.last());
    path
}

/// A torus about the y axis, in the plane y = 0. `thickness` is the radius of its tube.
pub fn ring(radius: f64, thickness: f64, segments: usize, sides: usize) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..=segments {
        let (sin, cos) = sine_cosine(360.0 * (i % segments) as f64 / segments as f64);
        for j in 0..=sides {
            let (up, out) = sine_cosine(360.0 * (j % sides) as f64 / sides as f64);
            let normal = dvec3(out * cos, up, out * sin);
            let position = dvec3(radius * cos, 0.0, radius * sin) + normal * thickness;
            mesh.vertex(position, normal, dvec2(i as f64 / segments as f64, j as f64 / sides as f64));
        }
    }
    let index = |i: usize, j: usize| i * (sides + 1) + j;
    for i in 0..segments {
        for j in 0..sides {
            mesh.patch([index(i, j), index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)]);
        }
    }
    mesh
}

/// A smooth surface over (u, v) in the unit square, with `columns` by `rows` patches. It faces ∂u × ∂v.
pub fn surface(columns: usize, rows: usize, at: impl Fn(f64, f64) -> DVec3) -> Mesh {
    const STEP: f64 = 1e-4;
    let mut mesh = Mesh::default();
    for i in 0..=columns {
        for j in 0..=rows {
            let (u, v) = (i as f64 / columns as f64, j as f64 / rows as f64);
            let along_u = at(u + STEP, v) - at(u - STEP, v);
            let along_v = at(u, v + STEP) - at(u, v - STEP);
            mesh.vertex(at(u, v), along_u.cross(along_v).normalize(), dvec2(u, v));
        }
    }
    let index = |i: usize, j: usize| i * (rows + 1) + j;
    for i in 0..columns {
        for j in 0..rows {
            mesh.patch([index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)]);
        }
    }
    mesh
}

/// A flat disc about the z axis that faces +z. The circle inscribed in the texture maps to its rim.
pub fn disc(radius: f64, segments: usize) -> Mesh {
    let mut mesh = Mesh::default();
    let middle = mesh.vertex(DVec3::ZERO, DVec3::Z, dvec2(0.5, 0.5));
    let rim: Vec<usize> = (0..segments)
        .map(|i| {
            let (sin, cos) = sine_cosine(360.0 * i as f64 / segments as f64);
            let uv = dvec2(0.5 + 0.5 * cos, 0.5 + 0.5 * sin);
            mesh.vertex(dvec3(radius * cos, radius * sin, 0.0), DVec3::Z, uv)
        })
        .collect();
    for i in 0..segments {
        mesh.triangles.push([middle, rim[i], rim[(i + 1) % segments]]);
    }
    mesh
}
