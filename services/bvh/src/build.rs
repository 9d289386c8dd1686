//! Builds the tree: a binary BVH by `obvhs`, which [`Collapse`] turns into one with eight children per node.

use crate::collapse::Collapse;
use crate::node::{Bvh, GROUP};
use glam::{Vec3, Vec3A};
use obvhs::{BvhBuildParams, bvh2::builder::build_bvh2_from_tris, triangle::Triangle};
use std::time::Duration;

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
        let mut build_time = Duration::ZERO; // Required by obvhs; not used here.
        let binary = build_bvh2_from_tris(&input, params, &mut build_time);
        Collapse::new(&binary, &input).run()
    }
}
