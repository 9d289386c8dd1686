//! Collapses the binary tree into a tree with eight children per node, at the least expected traversal cost.
//!
//! Dynamic programming over the surface area heuristic decides which binary nodes become wide nodes, and
//! which subtrees become one triangle group. It computes the cost of each subtree as 1 to 7 roots in the wide
//! node above (Ylitie, Karras and Laine 2017, "Efficient Incoherent Ray Traversal on GPUs Through Compressed
//! Wide BVHs", section 3.1). Children are stored in the order in which an any-hit query should visit them.

use crate::node::{Bvh, GROUP, Group, LEAF, Node, WIDTH};
use glam::{Vec3A, Vec4};
use obvhs::{
    bvh2::{Bvh2, node::Bvh2Node},
    triangle::Triangle,
};

/// Relative expected costs of visiting a node and of testing a triangle group.
const NODE_COST: f32 = 1.0;
const GROUP_COST: f32 = 0.7;

/// Cost of a binary subtree as a forest of at most 1, 2, … 7 roots, times the area of its box.
type Forest = [f32; WIDTH - 1];

/// Cost and contents of a binary subtree.
#[derive(Debug, Clone, Copy, Default)]
struct Subtree {
    cost: Forest,
    /// Number of triangles. A split triangle counts once in each binary leaf that holds a piece of it.
    triangles: u32,
    /// Total area of these triangles.
    area: f32,
    /// `true` if the subtree is cheapest as one triangle group.
    leaf: bool,
    /// Priority of the subtree in an any-hit query: probability of a hit divided by the expected cost.
    promise: f32,
}

/// Boxes are widened by this fraction of their longest side.
const BOX_SLACK: f32 = 1.0 / 2_097_152.0;

pub(crate) struct Collapse<'a> {
    binary: &'a Bvh2,
    input: &'a [Triangle],
    subtrees: Vec<Subtree>,
    out: Bvh,
}

impl<'a> Collapse<'a> {
    /// Computes the costs of all subtrees, from the leaves up.
    pub fn new(binary: &'a Bvh2, input: &'a [Triangle]) -> Self {
        let subtrees = vec![Subtree::default(); binary.nodes.len()];
        let mut collapse = Self { binary, input, subtrees, out: Bvh::default() };
        // List parents before children, then process the list backwards.
        let mut order = vec![0u32];
        let mut next = 0;
        while let Some(&index) = order.get(next) {
            let node = &binary.nodes[index as usize];
            if !node.is_leaf() {
                order.extend([node.first_index, node.first_index + 1]);
            }
            next += 1;
        }
        for &index in order.iter().rev() {
            collapse.subtrees[index as usize] = collapse.subtree(&binary.nodes[index as usize]);
        }
        collapse
    }

    fn subtree(&self, node: &Bvh2Node) -> Subtree {
        let box_area = node.aabb.half_area();
        let as_group = box_area * GROUP_COST;
        let mut subtree = if node.is_leaf() {
            let area = |&i: &u32| {
                let Triangle { v0, v1, v2 } = self.input[i as usize];
                // A split triangle contributes at most the area of its piece's box.
                (0.5 * (v1 - v0).cross(v2 - v0).length()).min(box_area)
            };
            Subtree {
                cost: [as_group; WIDTH - 1],
                triangles: node.prim_count,
                area: self.primitives(node).iter().map(area).sum(),
                leaf: true,
                promise: 0.0,
            }
        } else {
            let [left, right] = [0, 1].map(|i| &self.subtrees[(node.first_index + i) as usize]);
            let triangles = left.triangles + right.triangles;
            let (forest, _) = halves(&left.cost, &right.cost, WIDTH);
            let as_node = box_area * NODE_COST + forest;
            let leaf = triangles <= GROUP as u32 && as_group <= as_node;
            let mut cost = [if leaf { as_group } else { as_node }; WIDTH - 1];
            for roots in 2..WIDTH {
                cost[roots - 1] = halves(&left.cost, &right.cost, roots).0.min(cost[roots - 2]);
            }
            Subtree { cost, triangles, area: left.area + right.area, leaf, promise: 0.0 }
        };
        // A random ray through the box would meet `x = area / box_area` triangles on average. Because
        // triangles hide each other, the probability of a hit is about `x / (1 + x)`.
        let floor = box_area.max(f32::MIN_POSITIVE);
        let covered = subtree.area / floor;
        let promise = covered / (1.0 + covered) / (subtree.cost[0] / floor).max(GROUP_COST);
        subtree.promise = if promise.is_finite() { promise } else { 0.0 };
        subtree
    }

    /// Writes the wide tree.
    pub fn run(mut self) -> Bvh {
        self.out.nodes.push(Node::EMPTY);
        // Entries: (wide node to fill, binary node, level). Depth-first order keeps subtrees together in
        // memory.
        let mut pending = vec![(0u32, 0u32, 1)];
        while let Some((wide, binary, level)) = pending.pop() {
            self.out.depth = self.out.depth.max(level);
            for (slot, child) in self.children(binary).into_iter().enumerate() {
                let source = &self.binary.nodes[child as usize];
                // The triangle test shears the corners along the ray. The rounding error of a corner's
                // distance, a few 2⁻²⁴ of the box's longest side, then appears across the ray. Without slack,
                // the box test would reject valid hits on narrow triangles.
                let slack = (source.aabb.max - source.aabb.min).max_element() * BOX_SLACK;
                let (lower, upper) =
                    ((source.aabb.min - slack).to_array(), (source.aabb.max + slack).to_array());
                let reference = if self.subtrees[child as usize].leaf {
                    self.group(child)
                } else {
                    let index = self.out.nodes.len() as u32;
                    self.out.nodes.push(Node::EMPTY);
                    pending.push((index, child, level + 1));
                    index
                };
                let node = &mut self.out.nodes[wide as usize];
                for axis in 0..3 {
                    node.bounds[0][axis][slot] = lower[axis];
                    node.bounds[1][axis][slot] = upper[axis];
                }
                node.children[slot] = reference;
            }
        }
        self.out.nodes.shrink_to_fit();
        self.out.groups.shrink_to_fit();
        self.out
    }

    /// The descendants of `root` that become its wide node's children. The last has the highest priority.
    fn children(&self, root: u32) -> Vec<u32> {
        let mut children = Vec::with_capacity(WIDTH);
        if self.subtrees[root as usize].leaf {
            children.push(root); // the whole tree is one group
        } else {
            self.open(root, WIDTH, &mut children);
        }
        children.sort_by(|&a, &b| {
            let promise = |i: u32| self.subtrees[i as usize].promise;
            promise(a).total_cmp(&promise(b))
        });
        children
    }

    /// Replaces an inner node by its two children, which together become `roots` roots.
    fn open(&self, node: u32, roots: usize, children: &mut Vec<u32>) {
        let first = self.binary.nodes[node as usize].first_index;
        let cost = |i: u32| &self.subtrees[i as usize].cost;
        let (_, left) = halves(cost(first), cost(first + 1), roots);
        for (half, mut roots) in [(first, left.min(WIDTH - 1)), (first + 1, (roots - left).min(WIDTH - 1))] {
            // Do not spend a root that does not lower the cost.
            while roots > 1 && cost(half)[roots - 1] == cost(half)[roots - 2] {
                roots -= 1;
            }
            if roots == 1 {
                children.push(half);
            } else {
                self.open(half, roots, children);
            }
        }
    }

    /// Makes one group of all triangles in a binary subtree.
    fn group(&mut self, root: u32) -> u32 {
        let mut members: Vec<u32> = Vec::with_capacity(GROUP);
        let mut pending = vec![root];
        while let Some(index) = pending.pop() {
            let node = &self.binary.nodes[index as usize];
            if node.is_leaf() {
                for &primitive in self.primitives(node) {
                    // Two pieces of a split triangle may end up in the same group.
                    if !members.contains(&primitive) {
                        members.push(primitive);
                    }
                }
            } else {
                pending.extend([node.first_index + 1, node.first_index]);
            }
        }
        debug_assert!(!members.is_empty() && members.len() <= GROUP);
        let lane = |i: usize| members[i.min(members.len() - 1)];
        let corner = |select: fn(&Triangle) -> Vec3A| {
            let p: [Vec3A; GROUP] = std::array::from_fn(|i| select(&self.input[lane(i) as usize]));
            let axis = |a: usize| Vec4::new(p[0][a], p[1][a], p[2][a], p[3][a]);
            [axis(0), axis(1), axis(2)]
        };
        let corners = [corner(|t| t.v0), corner(|t| t.v1), corner(|t| t.v2)];
        self.out.groups.push(Group { corners, primitives: std::array::from_fn(lane) });
        LEAF | (self.out.groups.len() - 1) as u32
    }

    fn primitives(&self, leaf: &Bvh2Node) -> &'a [u32] {
        &self.binary.primitive_indices[leaf.first_index as usize..][..leaf.prim_count as usize]
    }
}

/// Least cost of two sibling subtrees as `roots` ≥ 2 roots, and the number of the left one.
fn halves(left: &Forest, right: &Forest, roots: usize) -> (f32, usize) {
    let cost = |k: usize| left[k.min(WIDTH - 1) - 1] + right[(roots - k).min(WIDTH - 1) - 1];
    (2..roots).fold((cost(1), 1), |best, k| if cost(k) < best.0 { (cost(k), k) } else { best })
}
