//! Builds the tree: a binary BVH by `obvhs`, which [`Collapse`] turns into one with eight children per node.

use crate::collapse::Collapse;
use crate::node::{Bvh, GROUP};
use crate::reinsertion::optimize;
use glam::{Vec3, Vec3A};
use obvhs::bvh2::{Bvh2, leaf_collapser::collapse};
use obvhs::splits::split_aabbs_preset;
use obvhs::{Boundable, BvhBuildParams, aabb::Aabb, ploc::PlocBuilder, triangle::Triangle};

impl Bvh {
    /// Builds the tree over `triangles`, each three indices into `positions` (finite, in metres).
    ///
    /// # Panics
    /// If an index is out of range. The scene loader has checked all indices by then.
    pub fn build(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let corner = |i: u32| Vec3A::from(positions[i as usize]);
        let input: Vec<Triangle> = triangles
            .iter()
            .map(|&[a, b, c]| Triangle { v0: corner(a), v1: corner(b), v2: corner(c) })
            .collect();
        if input.is_empty() {
            return Self::default();
        }
        // Spatial splits help large triangles with mostly empty boxes. Most shots build the tree once, so the
        // slow preset is worth a second per million triangles.
        let params = BvhBuildParams { max_prims_per_leaf: GROUP as u32, ..BvhBuildParams::slow_build() };
        Collapse::new(&binary(&input, &params), &input).run()
    }
}

/// The binary tree, as `obvhs::bvh2::builder::build_bvh2_from_tris` builds it on one thread.
fn binary(input: &[Triangle], params: &BvhBuildParams) -> Bvh2 {
    let mut boxes: Vec<Aabb> = input.iter().map(Boundable::aabb).collect();
    let mut indices: Vec<u32> = (0..input.len() as u32).collect();
    let areas = || boxes.iter().map(Aabb::half_area);
    let (sum, largest) = (areas().sum::<f32>(), areas().fold(0.0, f32::max));
    split_aabbs_preset(&mut boxes, &mut indices, input, sum / input.len() as f32, largest);
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        params.ploc_search_distance,
        &boxes,
        indices,
        params.sort_precision,
        params.search_depth_threshold,
    );
    binary.uses_spatial_splits = true;
    let ratio = params.reinsertion_batch_ratio;
    optimize(&mut binary, ratio);
    collapse(&mut binary, params.max_prims_per_leaf, params.collapse_traversal_cost);
    optimize(&mut binary, ratio * params.post_collapse_reinsertion_batch_ratio_multiplier);
    binary
}
