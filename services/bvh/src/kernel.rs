//! One ray against eight boxes: the portable kernel and the AVX2 kernel, bit for bit the same.

use crate::node::Node;
use crate::ray::Ray;
use glam::{Vec3, Vec4};

/// Relative widening of a box's exit distance that makes the slab test conservative in f32:
/// 1 + 2γ₃, γ₃ = 3ε/(1−3ε) (Ize 2013, "Robust BVH Ray Traversal").
const EXIT_SCALE: f32 = 1.0 + 3.6e-7;

/// A ray prepared for box tests.
#[derive(Clone, Copy)]
pub(crate) struct BoxRay {
    pub origin: Vec3,
    pub inverse: Vec3,
    /// For each axis, which of `Node::bounds` the ray meets first.
    pub first: [usize; 3],
    pub t_min: f32,
}

impl BoxRay {
    pub fn new(ray: &Ray) -> Self {
        let inverse = ray.direction.recip();
        // By the sign bit, so that a direction of −0 agrees with its inverse −∞.
        let first = inverse.to_array().map(|i| usize::from(i.is_sign_negative()));
        Self { origin: ray.origin, inverse, first, t_min: ray.t_min }
    }
}

/// Where the ray enters each of eight boxes, and the bit mask of those that it meets before `t_max`.
pub(crate) struct Boxes {
    pub near: [f32; 8],
    pub mask: u32,
}

/// A way of testing boxes. Comparisons are written so that a NaN (0 · ∞: the ray runs inside a slab's plane)
/// leaves the interval as it was: such an axis does not exclude the box.
pub(crate) trait Kernel: Copy {
    fn boxes(self, node: &Node, ray: &BoxRay, t_max: f32) -> Boxes;
}

/// Two times four lanes in glam's vectors: works everywhere.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

impl Kernel for Portable {
    #[inline(always)]
    fn boxes(self, node: &Node, ray: &BoxRay, t_max: f32) -> Boxes {
        let mut near = [0.0; 8];
        let mut mask = 0;
        for half in 0..2 {
            let mut enter = Vec4::splat(ray.t_min);
            let mut leave = Vec4::splat(t_max);
            for axis in 0..3 {
                let lanes = |side: usize| Vec4::from_slice(&node.bounds[side][axis][half * 4..]);
                let first = (lanes(ray.first[axis]) - ray.origin[axis]) * ray.inverse[axis];
                let last = (lanes(1 - ray.first[axis]) - ray.origin[axis]) * ray.inverse[axis] * EXIT_SCALE;
                enter = Vec4::select(first.cmpgt(enter), first, enter);
                leave = Vec4::select(last.cmplt(leave), last, leave);
            }
            near[half * 4..half * 4 + 4].copy_from_slice(&enter.to_array());
            mask |= enter.cmple(leave).bitmask() << (half * 4);
        }
        Boxes { near, mask }
    }
}

/// Eight lanes at once. A value of this type is the proof that the processor has AVX2.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

#[cfg(target_arch = "x86_64")]
impl Avx2 {
    /// The kernel, if this processor can run it.
    #[inline]
    pub fn detect() -> Option<Self> {
        std::arch::is_x86_feature_detected!("avx2").then_some(Self(()))
    }
}

#[cfg(target_arch = "x86_64")]
impl Kernel for Avx2 {
    #[inline(always)]
    fn boxes(self, node: &Node, ray: &BoxRay, t_max: f32) -> Boxes {
        use std::arch::x86_64::*;
        let mut near = [0.0; 8];
        // SAFETY: `self` exists only where AVX2 was detected; every load and store is of eight f32 inside an array of eight.
        let mask = unsafe {
            let mut enter = _mm256_set1_ps(ray.t_min);
            let mut leave = _mm256_set1_ps(t_max);
            for axis in 0..3 {
                let origin = _mm256_set1_ps(ray.origin[axis]);
                let inverse = _mm256_set1_ps(ray.inverse[axis]);
                let plane = |side: usize| {
                    let p = _mm256_loadu_ps(node.bounds[side][axis].as_ptr());
                    _mm256_mul_ps(_mm256_sub_ps(p, origin), inverse)
                };
                let first = plane(ray.first[axis]);
                let last = _mm256_mul_ps(plane(1 - ray.first[axis]), _mm256_set1_ps(EXIT_SCALE));
                // max and min return their second operand when either is NaN.
                enter = _mm256_max_ps(first, enter);
                leave = _mm256_min_ps(last, leave);
            }
            _mm256_storeu_ps(near.as_mut_ptr(), enter);
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(enter, leave)) as u32
        };
        Boxes { near, mask }
    }
}
