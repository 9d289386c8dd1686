//! Finds shells: closed opaque surfaces.

use super::weld::{Edges, Groups, Sets, number};
use crate::bounds::Bounds;
use forelight_scene::Geometry;

/// Triangles without a border: every edge belongs to an even number of them.
pub struct Shell {
    /// Triangle indices, ascending.
    pub triangles: Vec<u32>,
    pub bounds: Bounds,
    /// Whether all geometric normals point outward (`Some(true)`) or inward. `None` if mixed.
    pub outward: Option<bool>,
}

/// Finds the shells of some opaque triangles. `corners` holds the welded vertices of every triangle of the
/// scene. A sheet with a free border is no part of a shell, and does not open the shell that it is joined to.
pub fn shells(geometry: &Geometry, corners: &[[u32; 3]], opaque: &[u32]) -> Vec<Shell> {
    let proper = |&t: &u32| {
        let [a, b, c] = corners[t as usize];
        a != b && b != c && c != a
    };
    let triangles: Vec<u32> = opaque.iter().copied().filter(proper).collect();
    let corners: Vec<[u32; 3]> = triangles.iter().map(|&t| corners[t as usize]).collect();
    let edges = Edges::new(geometry.positions.len(), &corners);
    let alive = peel(&edges);
    let mut sets = Sets::new(corners.len());
    let sides = |edge: u32| edges.sides(edge).iter().filter(|&&side| alive[side as usize / 3]);
    for edge in 0..edges.len() as u32 {
        let mut on_edge = sides(edge);
        if let Some(first) = on_edge.next() {
            on_edge.for_each(|side| sets.join(first / 3, side / 3));
        }
    }
    let (numbers, count) = number(&sets.representatives(), |t| alive[t]);
    let groups = Groups::new(count, numbers.iter().copied());
    let forward = |side: u32| {
        let (t, s) = (side as usize / 3, side as usize % 3);
        corners[t][s] < corners[t][(s + 1) % 3]
    };
    let mut found = Vec::new();
    for shell in 0..count as u32 {
        let members = groups.get(shell);
        let on_edges =
            || members.iter().flat_map(|&t| (3 * t..3 * t + 3).map(|side| edges.of_side[side as usize]));
        if members.len() < 4 || on_edges().any(|edge| sides(edge).count() % 2 == 1) {
            continue;
        }
        let consistent = on_edges().all(|edge| {
            let mut pair = sides(edge);
            matches!((pair.next(), pair.next(), pair.next()), (Some(&a), Some(&b), None) if forward(a) != forward(b))
        });
        let triangles: Vec<u32> = members.iter().map(|&t| triangles[t as usize]).collect();
        let bounds = Bounds::of(triangles.iter().flat_map(|&t| geometry.corners(t)));
        let outward = if consistent { winds_outward(geometry, &triangles, &bounds) } else { None };
        found.push(Shell { triangles, bounds, outward });
    }
    found
}

/// Repeatedly removes triangles with a free edge. Returns which triangles remain.
fn peel(edges: &Edges) -> Vec<bool> {
    let mut alive = vec![true; edges.of_side.len() / 3];
    let mut left: Vec<u32> = (0..edges.len() as u32).map(|edge| edges.sides(edge).len() as u32).collect();
    let mut free: Vec<u32> = (0..edges.len() as u32).filter(|&edge| left[edge as usize] == 1).collect();
    while let Some(edge) = free.pop() {
        // The only triangle left at this edge, unless it was already removed via another edge.
        let last = edges.sides(edge).iter().map(|side| side / 3).find(|&t| alive[t as usize]);
        let Some(t) = last else { continue };
        alive[t as usize] = false;
        for side in 3 * t..3 * t + 3 {
            let edge = edges.of_side[side as usize];
            left[edge as usize] -= 1;
            if left[edge as usize] == 1 {
                free.push(edge);
            }
        }
    }
    alive
}

/// The sign of the volume enclosed by consistently wound triangles. `None` if the volume is close to zero.
fn winds_outward(geometry: &Geometry, triangles: &[u32], bounds: &Bounds) -> Option<bool> {
    let size = (bounds.high - bounds.low).as_dvec3();
    let centre = bounds.low.as_dvec3() + 0.5 * size;
    let volume: f64 = triangles
        .iter()
        .map(|&t| {
            let [a, b, c] = geometry.corners(t).map(|p| p.as_dvec3() - centre);
            a.dot(b.cross(c)) / 6.0
        })
        .sum();
    (volume.abs() > 1e-9 * size.element_product()).then_some(volume > 0.0)
}
