//! From two children a node to eight, at the least expected cost, in an order that finds occluders early.
//!
//! Which binary nodes become wide nodes, and which become groups of triangles, is decided by dynamic programming over
//! the surface area heuristic (Ylitie, Karras and Laine 2017, "Efficient Incoherent Ray Traversal on GPUs Through
//! Compressed Wide BVHs", section 3.1): the cost of a binary subtree is known for every number of roots, 1 to 7, that
//! may stand for it in the wide node above, from the costs of its two halves.

use crate::node::{Bvh, GROUP, Group, LEAF, Node, WIDTH};
use glam::{Vec3A, Vec4};
use obvhs::{
    bvh2::{Bvh2, node::Bvh2Node},
    triangle::Triangle,
};

/// Expected cost of visiting a node, and of testing a group of triangles, in proportion to each other.
const NODE_COST: f32 = 1.0;
const GROUP_COST: f32 = 0.7;

/// Costs of a binary subtree as a forest of at most 1, 2, … 7 roots, each times the area of its box.
type Forest = [f32; WIDTH - 1];

/// What is known of a binary node.
#[derive(Debug, Clone, Copy, Default)]
struct Subtree {
    cost: Forest,
    /// Triangles, counted once in every binary leaf that holds a piece of them.
    triangles: u32,
    /// Area of these triangles.
    area: f32,
    /// Whether it is cheapest as one group.
    leaf: bool,
    /// How soon a ray that looks for any hit should go there: probability of a hit by expected cost.
    promise: f32,
}

/// Share of a box's longest side by which it is widened.
const BOX_SLACK: f32 = 1.0 / 2_097_152.0;

pub(crate) struct Collapse<'a> {
    binary: &'a Bvh2,
    input: &'a [Triangle],
    subtrees: Vec<Subtree>,
    out: Bvh,
}

impl<'a> Collapse<'a> {
    /// Computes all costs from the leaves up.
    pub fn new(binary: &'a Bvh2, input: &'a [Triangle]) -> Self {
        let subtrees = vec![Subtree::default(); binary.nodes.len()];
        let mut collapse = Self { binary, input, subtrees, out: Bvh::default() };
        // Parents before children, then backwards.
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
                // Of a triangle that was split, no more than fits into the piece's box.
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
        // A ray that meets the box meets on average area/box_area of its triangles, if these faced anywhere; where
        // they hide each other fewer are met, for which x/(1+x) stands in.
        let floor = box_area.max(f32::MIN_POSITIVE);
        let covered = subtree.area / floor;
        let promise = covered / (1.0 + covered) / (subtree.cost[0] / floor).max(GROUP_COST);
        subtree.promise = if promise.is_finite() { promise } else { 0.0 };
        subtree
    }

    /// Writes the wide tree.
    pub fn run(mut self) -> Bvh {
        self.out.nodes.push(Node::EMPTY);
        // (wide node to fill, binary node that it stands for, level); depth first, so that subtrees lie together in memory.
        let mut pending = vec![(0u32, 0u32, 1)];
        while let Some((wide, binary, level)) = pending.pop() {
            self.out.depth = self.out.depth.max(level);
            for (slot, child) in self.children(binary).into_iter().enumerate() {
                let source = &self.binary.nodes[child as usize];
                // The triangle test shears corners along the ray: what a corner's distance along the ray is off by, a few 2⁻²⁴ of
                // the box's longest side, shows across it. A box that is tighter than that would hide hits at long, narrow triangles.
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

    /// The descendants of `root` that become the children of its wide node, the most promising last.
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

    /// Replaces an inner node by its two halves, which become `roots` roots together.
    fn open(&self, node: u32, roots: usize, children: &mut Vec<u32>) {
        let first = self.binary.nodes[node as usize].first_index;
        let cost = |i: u32| &self.subtrees[i as usize].cost;
        let (_, left) = halves(cost(first), cost(first + 1), roots);
        for (half, mut roots) in [(first, left.min(WIDTH - 1)), (first + 1, (roots - left).min(WIDTH - 1))] {
            // What gains nothing from a further root does without.
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

    /// Makes a group of the triangles of a binary subtree.
    fn group(&mut self, root: u32) -> u32 {
        let mut members: Vec<u32> = Vec::with_capacity(GROUP);
        let mut pending = vec![root];
        while let Some(index) = pending.pop() {
            let node = &self.binary.nodes[index as usize];
            if node.is_leaf() {
                for &primitive in self.primitives(node) {
                    // Two pieces of one triangle may have come together again.
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

/// The least cost of two subtrees as a forest of `roots` roots, at least 2, and how many of them the left one gets then.
fn halves(left: &Forest, right: &Forest, roots: usize) -> (f32, usize) {
    let cost = |k: usize| left[k.min(WIDTH - 1) - 1] + right[(roots - k).min(WIDTH - 1) - 1];
    (2..roots).fold((cost(1), 1), |best, k| if cost(k) < best.0 { (cost(k), k) } else { best })
}
