//! Improves a binary tree by moving subtrees to where they enlarge boxes least (Meister and Bittner 2018,
//! "Parallel Reinsertion for Bounding Volume Hierarchy Optimization"). The steps are those of `obvhs`.
//!
//! The search for better places takes two thirds of a build, so all threads share it. `obvhs` can do that
//! too, but then also sorts on all threads. Its order of equal elements, and so the tree, would depend on
//! their number. Here, only the search is shared, and the tree is that of one thread.

use obvhs::bvh2::reinsertion::{Reinsertion, find_reinsertion, reinsert_node};
use obvhs::bvh2::{Bvh2, node::Bvh2Node};
use rdst::{RadixKey, RadixSort};

/// Searches that are worth a thread.
const LEAST: usize = 256;

/// Moves subtrees in sixteen passes. The first considers the share `ratio` of all nodes, later ones fewer.
pub(crate) fn optimize(bvh: &mut Bvh2, ratio: f32) {
    if bvh.nodes.first().is_none_or(Bvh2Node::is_leaf) {
        return;
    }
    bvh.init_parents_if_uninit();
    bvh.children_are_ordered_after_parents = false;
    let mut touched = vec![false; bvh.nodes.len()];
    for pass in 0..16 {
        let share = 1.0 / (2 * pass + 1) as f32;
        let batch = ((bvh.nodes.len() as f32 * ratio * share) as usize).max(1);
        let batch = batch.min(bvh.nodes.len() - 1);
        let found = forelight_threads::map(&candidates(bvh, batch), LEAST, |candidate| {
            find_reinsertion(bvh, candidate.node as usize)
        });
        let mut better: Vec<Reinsertion> = found.into_iter().filter(|found| found.area_diff > 0.0).collect();
        better.sort_unstable_by(|a, b| b.area_diff.total_cmp(&a.area_diff));
        touched.fill(false);
        better.iter().for_each(|reinsertion| apply(bvh, reinsertion, &mut touched));
    }
}

/// The largest `count` nodes near the top of the tree.
fn candidates(bvh: &Bvh2, count: usize) -> Vec<Candidate> {
    let top = bvh.nodes.iter().enumerate().take(2 * (count + 1)).skip(1);
    let mut candidates: Vec<Candidate> =
        top.map(|(node, at)| Candidate { node: node as u32, area: at.aabb().half_area() }).collect();
    candidates.radix_sort_unstable();
    candidates.truncate(count);
    candidates
}

/// Moves a subtree, unless a move of this pass has changed its surroundings.
fn apply(bvh: &mut Bvh2, reinsertion: &Reinsertion, touched: &mut [bool]) {
    let (from, to) = (reinsertion.from as usize, reinsertion.to as usize);
    let around =
        [to, from, Bvh2Node::get_sibling_id(from), bvh.parents[to] as usize, bvh.parents[from] as usize];
    if around.iter().any(|&node| touched[node]) {
        return;
    }
    around.iter().for_each(|&node| touched[node] = true);
    reinsert_node(bvh, from, to);
}

#[derive(Clone, Copy)]
struct Candidate {
    node: u32,
    area: f32,
}

/// Large areas first.
impl RadixKey for Candidate {
    const LEVELS: usize = 4;

    fn get_level(&self, level: usize) -> u8 {
        (-self.area).get_level(level)
    }
}
