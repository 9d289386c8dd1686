//! When a frame is finished on several nodes, by the way that it is divided. All in work.

use forelight_forecast::PixelCurve;
use forelight_tracer::Tiling;
use serde::Serialize;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Edge of a bucket, pixels.
const BUCKET: u32 = 64;

/// What is spent beside the pixels.
#[derive(Debug, Clone, Copy)]
pub struct Overhead {
    /// By every node: opening the scene, its acceleration structure, reading a cache.
    pub part: u64,
    /// Before parts of equal forecast cost begin.
    pub division: u64,
}

/// Work until the last node has finished.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Makespans {
    /// Parts of equal forecast cost.
    pub equal_cost: u64,
    /// Parts of equally many pixels, along the same curve.
    pub equal_areas: u64,
    /// Square buckets in rows. Each goes to the node that is free first.
    pub buckets: u64,
}

/// The makespans on as many nodes as there are `ends` of parts. `work` is that of all pixels in rows.
pub fn makespans(curve: &PixelCurve, work: &[u64], ends: &[u32], overhead: Overhead) -> Makespans {
    let Overhead { part, division } = overhead;
    let along: Vec<u64> = curve.pixels(0..curve.count()).iter().map(|&pixel| work[pixel as usize]).collect();
    let nodes = ends.len();
    let areas: Vec<u32> = (1..=nodes).map(|node| (along.len() * node / nodes) as u32).collect();
    Makespans {
        equal_cost: division + part + longest(&along, ends),
        equal_areas: part + longest(&along, &areas),
        buckets: part + handed_out(buckets(curve, work), nodes),
    }
}

/// Work of the longest part.
fn longest(along: &[u64], ends: &[u32]) -> u64 {
    let mut from = 0;
    let parts = ends.iter().map(|&to| {
        let start = std::mem::replace(&mut from, to as usize);
        along[start..from].iter().sum()
    });
    parts.max().unwrap_or(0)
}

fn buckets(curve: &PixelCurve, work: &[u64]) -> impl Iterator<Item = u64> {
    let tiling = Tiling::new(curve.width(), curve.height(), BUCKET);
    (0..tiling.count()).map(move |tile| tiling.pixels(tile).iter().map(|&pixel| work[pixel as usize]).sum())
}

/// When the last of some pieces is finished, if each goes to the node that is free first (Graham 1966).
fn handed_out(pieces: impl Iterator<Item = u64>, nodes: usize) -> u64 {
    let mut free: BinaryHeap<Reverse<u64>> = vec![Reverse(0); nodes].into();
    let mut end = 0;
    for piece in pieces {
        let Reverse(start) = free.pop().unwrap_or_default();
        end = end.max(start + piece);
        free.push(Reverse(start + piece));
    }
    end
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_go_to_the_node_that_is_free_first() {
        assert_eq!(handed_out([3, 3, 4].into_iter(), 2), 7);
        assert_eq!(handed_out([4, 3, 3].into_iter(), 2), 6);
        assert_eq!(handed_out([5].into_iter(), 9), 5);
        assert_eq!(handed_out(std::iter::empty(), 1), 0);
    }

    #[test]
    fn each_way_counts_its_pixels_and_what_is_spent_beside_them() {
        // The right half of four buckets costs three times as much.
        let (width, height) = (128, 128);
        let work: Vec<u64> = (0..width * height).map(|i| if i % width < 64 { 1 } else { 3 }).collect();
        let curve = PixelCurve::new(width, height);
        let overhead = Overhead { part: 10, division: 7 };
        let bucket = 64 * 64;
        // The curve goes through quarters: two on the left, then two on the right.
        let half = curve.count() / 2;
        let found = makespans(&curve, &work, &[half + half / 3, 2 * half], overhead);
        assert_eq!(found.equal_areas, 10 + 6 * bucket);
        // 1, 3, 1 and 3 in rows: the last of them begins after both that cost 1.
        assert_eq!(found.buckets, 10 + 5 * bucket);
        let share = found.equal_cost as f64 / (17 + 4 * bucket) as f64;
        assert!((share - 1.0).abs() < 0.001, "{found:?}");
    }
}
