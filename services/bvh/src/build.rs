//! Building: a binary tree by `obvhs`, collapsed to eight children a node.

use crate::node::{Bvh, Group, LEAF, Node};
use glam::{Vec3, Vec3A, Vec4};
use obvhs::{
    BvhBuildParams,
    bvh2::{Bvh2, builder::build_bvh2_from_tris, node::Bvh2Node},
    triangle::Triangle,
};
use std::time::Duration;

/// Triangles in a leaf at most: one group.
const LEAF_TRIANGLES: u32 = 4;

impl Bvh {
    /// Builds the tree over `triangles`, corner indices into `positions` (metres, finite).
    ///
    /// # Panics
    /// If an index is out of range; the loader of a scene has checked that.
    pub fn build(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let corner = |i: u32| Vec3A::from(positions[i as usize]);
        let input: Vec<Triangle> = triangles
            .iter()
            .map(|&[a, b, c]| Triangle { v0: corner(a), v1: corner(b), v2: corner(c) })
            .collect();
        if input.is_empty() {
            return Self::default();
        }
        // Splitting large triangles pays where their boxes are mostly empty; the tree is built once a shot in most cases,
        // so the slow preset is worth its second on a million triangles.
        let params = BvhBuildParams { max_prims_per_leaf: LEAF_TRIANGLES, ..BvhBuildParams::slow_build() };
        let mut build_time = Duration::ZERO; // obvhs wants to tell; nobody asks
        let binary = build_bvh2_from_tris(&input, params, &mut build_time);
        Collapse { binary: &binary, input: &input, out: Self::default() }.run()
    }
}

struct Collapse<'a> {
    binary: &'a Bvh2,
    input: &'a [Triangle],
    out: Bvh,
}

impl Collapse<'_> {
    fn run(mut self) -> Bvh {
        self.out.nodes.push(Node::EMPTY);
        // (wide node to fill, binary node that it stands for); depth first, so that subtrees lie together in memory.
        let mut pending = vec![(0u32, 0u32)];
        while let Some((wide, binary)) = pending.pop() {
            for (slot, &child) in self.frontier(binary).iter().enumerate() {
                let source = self.binary.nodes[child as usize];
                let (lower, upper) = (source.aabb.min.to_array(), source.aabb.max.to_array());
                let reference =
                    if source.is_leaf() { self.leaf(&source) } else { self.out.nodes.len() as u32 };
                let node = &mut self.out.nodes[wide as usize];
                for axis in 0..3 {
                    node.bounds[0][axis][slot] = lower[axis];
                    node.bounds[1][axis][slot] = upper[axis];
                }
                node.children[slot] = reference;
                if !source.is_leaf() {
                    self.out.nodes.push(Node::EMPTY);
                    pending.push((reference, child));
                }
            }
        }
        self.out.nodes.shrink_to_fit();
        self.out.groups.shrink_to_fit();
        self.out
    }

    /// Up to eight descendants of `root` that cover it: the inner node of the largest area is opened until eight are reached.
    fn frontier(&self, root: u32) -> Vec<u32> {
        let nodes = &self.binary.nodes;
        let mut frontier = vec![root];
        while frontier.len() < 8 {
            let largest =
                (0..frontier.len()).filter(|&i| !nodes[frontier[i] as usize].is_leaf()).max_by(|&i, &j| {
                    let area = |k: usize| nodes[frontier[k] as usize].aabb.half_area();
                    area(i).total_cmp(&area(j)).then(j.cmp(&i))
                });
            let Some(i) = largest else { break };
            let first = nodes[frontier[i] as usize].first_index;
            frontier[i] = first;
            frontier.push(first + 1);
        }
        frontier
    }

    fn leaf(&mut self, node: &Bvh2Node) -> u32 {
        let range = node.first_index as usize..(node.first_index + node.prim_count) as usize;
        let primitives = &self.binary.primitive_indices[range];
        debug_assert!(!primitives.is_empty() && primitives.len() <= LEAF_TRIANGLES as usize);
        let lane = |i: usize| primitives[i.min(primitives.len() - 1)];
        let corner = |select: fn(&Triangle) -> Vec3A| {
            let p: [Vec3A; 4] = std::array::from_fn(|i| select(&self.input[lane(i) as usize]));
            let axis = |a: usize| Vec4::new(p[0][a], p[1][a], p[2][a], p[3][a]);
            [axis(0), axis(1), axis(2)]
        };
        let corners = [corner(|t| t.v0), corner(|t| t.v1), corner(|t| t.v2)];
        self.out.groups.push(Group { corners, primitives: std::array::from_fn(lane) });
        LEAF | (self.out.groups.len() - 1) as u32
    }
}
