//! Mesh connectivity: welded vertices, edges, and disjoint sets.

use crate::random::hash;
use glam::Vec3;

/// For each vertex, the first one at exactly the same position. Linear time by an open hash table.
pub fn weld(positions: &[Vec3]) -> Vec<u32> {
    const FREE: u32 = u32::MAX;
    let mask = (2 * positions.len()).next_power_of_two().max(2) - 1;
    let mut table = vec![FREE; mask + 1];
    let first = |(index, position): (usize, &Vec3)| {
        // Adding zero turns −0 into 0.
        let [x, y, z] = (*position + 0.0).to_array().map(f32::to_bits);
        let mut slot = hash(u64::from(x) << 32 ^ u64::from(y) << 16 ^ hash(u64::from(z))) as usize & mask;
        loop {
            match table[slot] {
                FREE => {
                    table[slot] = index as u32;
                    return index as u32;
                }
                known if positions[known as usize] == *position => return known,
                _ => slot = (slot + 1) & mask,
            }
        }
    };
    positions.iter().enumerate().map(first).collect()
}

/// Disjoint sets of 0, 1, … The representative of a set is its lowest member.
pub struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    pub fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    fn find(&mut self, mut item: u32) -> u32 {
        while self.parent[item as usize] != item {
            let above = self.parent[self.parent[item as usize] as usize];
            self.parent[item as usize] = above;
            item = above;
        }
        item
    }

    /// The representative of every item.
    pub fn representatives(mut self) -> Vec<u32> {
        (0..self.parent.len() as u32).map(|item| self.find(item)).collect()
    }

    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

/// Numbers the sets consecutively, in the order of their first wanted item. Returns the number of each wanted
/// item's set, and the number of sets.
pub fn number(representatives: &[u32], wanted: impl Fn(usize) -> bool) -> (Vec<Option<u32>>, usize) {
    let mut numbers: Vec<Option<u32>> = vec![None; representatives.len()];
    let mut count = 0;
    for (item, &representative) in representatives.iter().enumerate() {
        if wanted(item) {
            // A representative is its set's lowest member, so it already has its number if wanted.
            let known = numbers[representative as usize];
            numbers[representative as usize] = known.or_else(|| {
                count += 1;
                Some(count - 1)
            });
            numbers[item] = numbers[representative as usize];
        }
    }
    (numbers, count as usize)
}

/// Items grouped, and ascending within each group.
pub struct Groups {
    start: Vec<u32>,
    items: Vec<u32>,
}

impl Groups {
    /// Groups 0 … `groups` − 1 of items 0, 1, … Items may have no group.
    pub fn new(groups: usize, of: impl Iterator<Item = Option<u32>> + Clone) -> Self {
        let mut start = vec![0u32; groups + 1];
        for group in of.clone().flatten() {
            start[group as usize + 1] += 1;
        }
        for g in 0..groups {
            start[g + 1] += start[g];
        }
        let mut next = start.clone();
        let mut items = vec![0; start[groups] as usize];
        for (item, group) in of.enumerate() {
            if let Some(group) = group {
                let slot = &mut next[group as usize];
                items[*slot as usize] = item as u32;
                *slot += 1;
            }
        }
        Self { start, items }
    }

    pub fn len(&self) -> usize {
        self.start.len() - 1
    }

    pub fn get(&self, group: u32) -> &[u32] {
        let (from, to) = (self.start[group as usize], self.start[group as usize + 1]);
        &self.items[from as usize..to as usize]
    }
}

/// The edges of triangles. Side `s` of triangle `t` runs from its corner `s` to the next.
pub struct Edges {
    /// Edge of each side (3 t + s).
    pub of_side: Vec<u32>,
    /// The sides of all edges in sequence, and where each edge begins.
    sides: Vec<u32>,
    start: Vec<u32>,
}

impl Edges {
    /// Finds the edges. `corners` are welded vertices, all below `vertices`.
    pub fn new(vertices: usize, corners: &[[u32; 3]]) -> Self {
        let ends = |side: u32| {
            let (t, s) = (side as usize / 3, side as usize % 3);
            (corners[t][s], corners[t][(s + 1) % 3])
        };
        let sides = 3 * corners.len() as u32;
        let lower = (0..sides).map(|side| {
            let (a, b) = ends(side);
            Some(a.min(b))
        });
        // Group the sides by their lower end. The few sides of each group are then sorted by their upper end.
        let Groups { start: at_vertex, items: mut sides } = Groups::new(vertices, lower);
        let mut of_side = vec![0; sides.len()];
        let mut start = Vec::with_capacity(sides.len() / 2 + 1);
        for range in at_vertex.windows(2) {
            let upper = |side: u32| {
                let (a, b) = ends(side);
                a.max(b)
            };
            let here = &mut sides[range[0] as usize..range[1] as usize];
            here.sort_unstable_by_key(|&side| (upper(side), side));
            let mut at = range[0];
            for edge in here.chunk_by(|&a, &b| upper(a) == upper(b)) {
                for &side in edge {
                    of_side[side as usize] = start.len() as u32;
                }
                start.push(at);
                at += edge.len() as u32;
            }
        }
        start.push(sides.len() as u32);
        Self { of_side, sides, start }
    }

    pub fn len(&self) -> usize {
        self.start.len() - 1
    }

    /// Sides (3 t + s) that lie on an edge.
    pub fn sides(&self, edge: u32) -> &[u32] {
        let (from, to) = (self.start[edge as usize], self.start[edge as usize + 1]);
        &self.sides[from as usize..to as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_positions_become_one_vertex_and_zero_has_no_sign() {
        let p = [Vec3::ONE, Vec3::ZERO, Vec3::ONE, -Vec3::ZERO, Vec3::X];
        assert_eq!(weld(&p), [0, 1, 0, 1, 4]);
        assert!(weld(&[]).is_empty());
    }

    #[test]
    fn two_triangles_of_a_square_share_one_edge() {
        let edges = Edges::new(10, &[[0, 1, 2], [0, 2, 3]]);
        assert_eq!(edges.len(), 5);
        assert_eq!(edges.of_side[2], edges.of_side[3]);
        assert_eq!(edges.sides(edges.of_side[2]), [2, 3]);
        assert_eq!(edges.sides(edges.of_side[0]), [0]);
        assert_eq!((0..5).map(|edge| edges.sides(edge).len()).sum::<usize>(), 6);
    }

    #[test]
    fn sets_are_named_by_their_lowest_member() {
        let mut sets = Sets::new(6);
        for (a, b) in [(5, 3), (4, 5), (1, 2)] {
            sets.join(a, b);
        }
        assert_eq!(sets.representatives(), [0, 1, 1, 3, 3, 3]);
    }
}
