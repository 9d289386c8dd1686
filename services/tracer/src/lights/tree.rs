//! A light tree: chooses lights in proportion to the light that they are estimated to bring to a point (Conty
//! Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting").
//!
//! Each node bounds the position of its lights and their directions. From the root, one of two children is
//! chosen by importance. That is zero only if none of its lights can reach the point, so no light that
//! matters is left out.

use super::bounds::{Bounds, Receiver, Shine};
use glam::Vec3;

/// Number of bins along each axis when a set of lights is split.
const BINS: usize = 12;

/// Larger sets are split only along the longest axis, by far the best one.
const ALL_AXES: usize = 4096;

#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Bounds,
    /// In an inner node, the first of two adjacent children. In a leaf, the light, with [`LEAF`] set.
    content: u32,
    parent: u32,
}

/// A choice among lights.
#[derive(Debug, Clone, Copy, Default)]
pub struct Choice {
    /// Uniform random number in [0, 1). After the choice its remainder, uniform but coarser.
    pub number: f64,
    /// The chosen light.
    pub light: usize,
    /// Probability of the choice. 0 before it, or if no light on the path can reach the receiver.
    pub probability: f64,
}

impl Choice {
    /// A choice still to be made with this random number.
    pub fn by(number: f64) -> Self {
        Self { number, ..Self::default() }
    }
}

const LEAF: u32 = 1 << 31;
const ROOT: u32 = 0;

/// The tree. Lights are identified by their index in the slice that it was built from.
#[derive(Debug, Clone, Default)]
pub struct LightTree {
    /// The root, an unused entry, then pairs of siblings at even and odd indices.
    nodes: Vec<Node>,
    /// Leaf of each light.
    leaves: Vec<u32>,
}

impl LightTree {
    /// Builds the tree. All lights must emit.
    pub fn new(lights: &[Bounds]) -> Self {
        if lights.is_empty() {
            return Self::default();
        }
        let mut members: Vec<Member> = lights
            .iter()
            .enumerate()
            .map(|(i, b)| Member { centre: b.centre(), bounds: *b, light: i as u32 })
            .collect();
        let root = Node { bounds: lights[0], content: LEAF, parent: ROOT };
        let mut tree = Self { nodes: vec![root, root], leaves: vec![ROOT; lights.len()] };
        tree.nodes.reserve(2 * lights.len());
        tree.fill(ROOT, &mut members);
        tree
    }

    /// Importance of all lights together.
    pub fn importance(&self, receiver: &Receiver) -> f64 {
        self.nodes.first().map_or(0.0, |root| root.bounds.importance(receiver))
    }

    /// Makes several choices, with ascending random numbers; common parts of paths are walked once. `visited`
    /// counts the nodes visited.
    pub fn choose(&self, receiver: &Receiver, choices: &mut [Choice], visited: &mut u64) {
        let Some(root) = self.nodes.first() else { return };
        if root.content & LEAF != 0 {
            *visited += 1;
            if root.bounds.importance(receiver) <= 0.0 {
                return;
            }
        }
        self.descend(root, receiver, choices, 1.0, visited);
    }

    fn descend(
        &self,
        node: &Node,
        receiver: &Receiver,
        choices: &mut [Choice],
        probability: f64,
        visited: &mut u64,
    ) {
        if node.content & LEAF != 0 {
            let light = (node.content & !LEAF) as usize;
            choices.iter_mut().for_each(|c| *c = Choice { light, probability, number: c.number });
            return;
        }
        *visited += 2;
        let pair = &self.nodes[node.content as usize..node.content as usize + 2];
        let Some(share) = share(pair, receiver) else { return };
        // The remainder of a random number is uniform again. Its strata stay together along the path.
        let (to_first, to_second) = choices.split_at_mut(choices.partition_point(|c| c.number < share));
        if !to_first.is_empty() {
            to_first.iter_mut().for_each(|c| c.number = (c.number / share).min(BELOW_ONE));
            self.descend(&pair[0], receiver, to_first, probability * share, visited);
        }
        if !to_second.is_empty() {
            let rest = 1.0 - share;
            to_second.iter_mut().for_each(|c| c.number = ((c.number - share) / rest).min(BELOW_ONE));
            self.descend(&pair[1], receiver, to_second, probability * rest, visited);
        }
    }

    /// Probability with which [`Self::choose`] chooses this light.
    pub fn probability(&self, receiver: &Receiver, light: usize, visited: &mut u64) -> f64 {
        let mut index = self.leaves[light];
        if index == ROOT {
            *visited += 1;
            return if self.importance(receiver) > 0.0 { 1.0 } else { 0.0 };
        }
        let mut probability = 1.0;
        while index != ROOT {
            *visited += 2;
            let first = (index & !1) as usize;
            let Some(share) = share(&self.nodes[first..first + 2], receiver) else { return 0.0 };
            probability *= if index as usize == first { share } else { 1.0 - share };
            index = self.nodes[index as usize].parent;
        }
        probability
    }

    /// Whether `is_near` holds for any light. `may_hold` decides by a node's bounds.
    pub fn any(&self, may_hold: impl Fn(&Bounds) -> bool, is_near: impl Fn(usize) -> bool) -> bool {
        // Depth-first without a stack: continue at the second sibling of the nearest first-sibling ancestor.
        let mut index = ROOT;
        if self.nodes.is_empty() {
            return false;
        }
        loop {
            let node = &self.nodes[index as usize];
            if may_hold(&node.bounds) {
                if node.content & LEAF == 0 {
                    index = node.content;
                    continue;
                }
                if is_near((node.content & !LEAF) as usize) {
                    return true;
                }
            }
            while index != ROOT && index & 1 == 1 {
                index = self.nodes[index as usize].parent;
            }
            if index == ROOT {
                return false;
            }
            index += 1;
        }
    }

    /// Fills node `index` with `members`.
    fn fill(&mut self, index: u32, members: &mut [Member]) {
        if let [member] = members {
            self.nodes[index as usize].bounds = member.bounds;
            self.nodes[index as usize].content = LEAF | member.light;
            self.leaves[member.light as usize] = index;
            return;
        }
        let middle = split(members);
        let first = self.nodes.len() as u32;
        let child = Node { parent: index, ..self.nodes[index as usize] };
        self.nodes.extend([child, child]);
        self.nodes[index as usize].content = first;
        let (left, right) = members.split_at_mut(middle);
        self.fill(first, left);
        self.fill(first + 1, right);
        self.nodes[index as usize].bounds =
            self.nodes[first as usize].bounds.union(&self.nodes[first as usize + 1].bounds);
    }
}

/// The largest number below 1.
pub const BELOW_ONE: f64 = 1.0 - f64::EPSILON / 2.0;

/// Probability of the first of a pair of children. `None` if neither can bring light.
fn share(pair: &[Node], receiver: &Receiver) -> Option<f64> {
    let (first, second) = (pair[0].bounds.importance(receiver), pair[1].bounds.importance(receiver));
    let sum = first + second;
    (sum > 0.0).then(|| first / sum)
}

/// A light while the tree is built.
#[derive(Debug, Clone, Copy)]
struct Member {
    centre: Vec3,
    bounds: Bounds,
    light: u32,
}

/// Sorts the members into two non-empty groups. Returns the start of the second.
fn split(members: &mut [Member]) -> usize {
    if members.len() == 2 {
        return 1;
    }
    let low = members.iter().fold(Vec3::INFINITY, |low, m| low.min(m.centre));
    let high = members.iter().fold(Vec3::NEG_INFINITY, |high, m| high.max(m.centre));
    let extent = high - low;
    let longest = extent.max_position();
    let mut best = (f64::INFINITY, longest, 0);
    for axis in 0..3 {
        if extent[axis] > 0.0 && (axis == longest || members.len() <= ALL_AXES) {
            let bin = |m: &Member| bin(m.centre[axis], low[axis], extent[axis]);
            let mut bins = [Shine::NONE; BINS];
            members.iter().for_each(|m| bins[bin(m)].add(&m.bounds));
            // Penalise thin splits (Conty Estevez and Kulla 2018, equation 2).
            let slimness = f64::from(extent[longest] / extent[axis]);
            let mut after = [0.0; BINS];
            let mut rest = Shine::NONE;
            for i in (1..BINS).rev() {
                rest.merge(&bins[i]);
                after[i] = rest.cost();
            }
            let mut before = Shine::NONE;
            for i in 1..BINS {
                before.merge(&bins[i - 1]);
                let cost = slimness * (before.cost() + after[i]);
                let (empty_before, empty_after) = (before.is_none(), after[i] == 0.0);
                if !empty_before && !empty_after && cost < best.0 {
                    best = (cost, axis, i);
                }
            }
        }
    }
    let (_, axis, plane) = best;
    let mut middle = 0;
    if plane > 0 {
        for i in 0..members.len() {
            if bin(members[i].centre[axis], low[axis], extent[axis]) < plane {
                members.swap(i, middle);
                middle += 1;
            }
        }
    }
    // If all lights are in one place, or costs are NaN, splitting in the middle is as good as anything.
    if middle == 0 || middle == members.len() { members.len() / 2 } else { middle }
}

fn bin(centre: f32, low: f32, extent: f32) -> usize {
    (((centre - low) / extent * BINS as f32) as usize).min(BINS - 1)
}

#[cfg(test)]
mod tests;
