//! Building: a binary tree by `obvhs`, collapsed to eight children a node.

use crate::collapse::Collapse;
use crate::node::{Bvh, GROUP};
use glam::{Vec3, Vec3A};
use obvhs::{BvhBuildParams, bvh2::builder::build_bvh2_from_tris, triangle::Triangle};
use std::time::Duration;

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
        let params = BvhBuildParams { max_prims_per_leaf: GROUP as u32, ..BvhBuildParams::slow_build() };
        let mut build_time = Duration::ZERO; // obvhs wants to tell; nobody asks
        let binary = build_bvh2_from_tris(&input, params, &mut build_time);
        Collapse::new(&binary, &input).run()
    }
}
