//! A bounding volume hierarchy over many boxes.

use crate::bounds::Bounds;
use glam::DVec3;

/// Largest number of items per leaf.
const LEAF: usize = 4;

/// A binary tree over boxes. Nodes are split at the median of the boxes' centres.
pub struct Tree {
    nodes: Vec<Node>,
    /// Items with their boxes. The items of a leaf are adjacent.
    items: Vec<(u32, Bounds)>,
}

struct Node {
    bounds: Bounds,
    /// Leaf: its first item. Inner node: its second child; the first child is the next node.
    at: u32,
    /// Number of items of a leaf. 0 marks an inner node.
    count: u32,
}

impl Tree {
    /// Builds the tree over items 0, 1, 2, … with these boxes.
    pub fn new(boxes: impl Iterator<Item = Bounds>) -> Self {
        let mut tree = Self { nodes: Vec::new(), items: boxes.zip(0..).map(|(b, i)| (i, b)).collect() };
        if !tree.items.is_empty() {
            tree.split(0, tree.items.len());
        }
        tree
    }

    /// Adds the subtree over a range of the items. Ranges are halved, so the recursion is at most 32 deep.
    fn split(&mut self, from: usize, to: usize) {
        let items = &mut self.items[from..to];
        let bounds = items.iter().fold(Bounds::EMPTY, |b, item| b.union(item.1));
        let index = self.nodes.len();
        self.nodes.push(Node { bounds, at: from as u32, count: (to - from) as u32 });
        if to - from <= LEAF {
            return;
        }
        let centre = |b: &Bounds| b.low + b.high;
        let spread = Bounds::of(items.iter().map(|item| centre(&item.1)));
        let axis = (spread.high - spread.low).max_position();
        let half = items.len() / 2;
        items.select_nth_unstable_by(half, |a, b| centre(&a.1)[axis].total_cmp(&centre(&b.1)[axis]));
        self.split(from, from + half);
        let second = self.nodes.len() as u32;
        self.nodes[index] = Node { bounds, at: second, count: 0 };
        self.split(from + half, to);
    }

    /// Calls `found` for items until it returns `true`: for all whose box `wanted` accepts, with every box around
    /// it in the tree. Where `wanted` refuses a box, nothing inside may matter.
    pub fn any(&self, wanted: impl Fn(&Bounds) -> bool, mut found: impl FnMut(u32) -> bool) -> bool {
        let mut stack = [0u32; 40];
        let mut height = usize::from(!self.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let index = stack[height];
            let node = &self.nodes[index as usize];
            if !wanted(&node.bounds) {
                continue;
            }
            if node.count == 0 {
                stack[height] = node.at;
                stack[height + 1] = index + 1;
                height += 2;
                continue;
            }
            let items = &self.items[node.at as usize..(node.at + node.count) as usize];
            if items.iter().any(|(item, bounds)| wanted(bounds) && found(*item)) {
                return true;
            }
        }
        false
    }

    /// Returns `true` if `found` returns `true` for any of the items whose boxes overlap `bounds`.
    pub fn any_overlapping(&self, bounds: &Bounds, found: impl FnMut(u32) -> bool) -> bool {
        self.any(|b| b.overlaps(bounds), found)
    }

    /// Calls `found` for every item whose box a half-line may meet.
    pub fn ahead(&self, origin: DVec3, direction: DVec3, mut found: impl FnMut(u32)) {
        let inverse = direction.recip();
        self.any(
            |b| b.is_ahead(origin, inverse),
            |item| {
                found(item);
                false
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn boxes() -> Vec<Bounds> {
        let number = |i: u64| (crate::random::hash(i) >> 40) as f32 / (1 << 24) as f32;
        let point = |i: u64| Vec3::new(number(3 * i), number(3 * i + 1), number(3 * i + 2));
        (0..1000).map(|i| Bounds::of([point(i), point(i) + 0.1 * point(i + 5000)])).collect()
    }

    #[test]
    fn the_tree_finds_what_testing_every_box_finds() {
        let boxes = boxes();
        let tree = Tree::new(boxes.iter().copied());
        for query in boxes.iter().step_by(7) {
            let mut found = Vec::new();
            tree.any_overlapping(query, |item| {
                found.push(item);
                false
            });
            found.sort_unstable();
            let expected: Vec<u32> = (0..1000).filter(|&i| boxes[i as usize].overlaps(query)).collect();
            assert_eq!(found, expected);
            let (origin, direction) = (query.low.as_dvec3(), DVec3::new(0.3, -0.5, 0.8));
            let mut found = Vec::new();
            tree.ahead(origin, direction, |item| found.push(item));
            found.sort_unstable();
            let ahead = |i: &u32| boxes[*i as usize].is_ahead(origin, direction.recip());
            assert_eq!(found, (0..1000).filter(ahead).collect::<Vec<u32>>());
            assert!(!found.is_empty());
        }
    }
}
