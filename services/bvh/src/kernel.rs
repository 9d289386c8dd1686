//! Tests one ray against eight boxes. The portable kernel and the AVX2 kernel return the same bits.

use crate::node::{Node, WIDTH};
use crate::ray::Ray;
use glam::{Vec3, Vec4};

/// Widening of a box's exit distance that makes the slab test conservative in f32: 1 + 2γ₄ with γ₄ = 4ε / (1
/// − 4ε), for the rounding of reciprocal, widening, difference and product (Ize 2013, "Robust BVH Ray
/// Traversal").
pub(crate) const EXIT_SCALE: f32 = 1.0 + 4.8e-7;

/// A ray prepared for box tests.
#[derive(Clone, Copy)]
pub(crate) struct BoxRay {
    pub origin: Vec3,
    pub inverse: Vec3,
    /// `inverse × EXIT_SCALE`, for the planes where the ray leaves a box.
    pub exit: Vec3,
    /// For each axis, the index into `Node::bounds` of the planes that the ray meets first.
    pub first: [usize; 3],
    pub t_min: f32,
}

impl BoxRay {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let inverse = ray.direction.recip();
        // Use the sign bit, so that a direction of −0 matches its inverse −∞.
        let first = inverse.to_array().map(|i| usize::from(i.is_sign_negative()));
        Self { origin: ray.origin, inverse, exit: inverse * EXIT_SCALE, first, t_min: ray.t_min }
    }
}

/// Where the ray enters each of eight boxes, and a bit mask of the boxes that it meets before `t_max`.
pub(crate) struct Boxes {
    pub near: [f32; WIDTH],
    pub mask: u32,
}

/// An implementation of the box test. A NaN, 0 · ∞, arises when the ray runs inside a slab's plane.
/// Comparisons are written so that a NaN leaves the interval unchanged.
pub(crate) trait Kernel: Copy {
    /// Tests the eight boxes of a node.
    fn boxes(self, node: &Node, ray: &BoxRay, t_max: f32) -> Boxes;

    /// Writes the children whose boxes the ray meets to the front of `children`, in slot order; the rest is
    /// undefined. Returns the bit mask of their slots.
    fn met(self, node: &Node, ray: &BoxRay, t_max: f32, children: &mut [u32; WIDTH]) -> u32;

    /// Prefetches memory that may be read soon.
    fn prefetch<T>(self, soon: Option<&T>);
}

/// The portable kernel: two times four lanes in glam vectors.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

impl Kernel for Portable {
    #[inline(always)]
    fn boxes(self, node: &Node, ray: &BoxRay, t_max: f32) -> Boxes {
        let mut near = [0.0; WIDTH];
        let mut mask = 0;
        for half in 0..2 {
            let mut enter = Vec4::splat(ray.t_min);
            let mut leave = Vec4::splat(t_max);
            for axis in 0..3 {
                let lanes = |side: usize| Vec4::from_slice(&node.bounds[side][axis][half * 4..]);
                let first = (lanes(ray.first[axis]) - ray.origin[axis]) * ray.inverse[axis];
                let last = (lanes(1 - ray.first[axis]) - ray.origin[axis]) * ray.exit[axis];
                enter = Vec4::select(first.cmpgt(enter), first, enter);
                leave = Vec4::select(last.cmplt(leave), last, leave);
            }
            near[half * 4..half * 4 + 4].copy_from_slice(&enter.to_array());
            mask |= enter.cmple(leave).bitmask() << (half * 4);
        }
        Boxes { near, mask }
    }

    #[inline(always)]
    fn met(self, node: &Node, ray: &BoxRay, t_max: f32, children: &mut [u32; WIDTH]) -> u32 {
        let mask = self.boxes(node, ray, t_max).mask;
        for (count, slot) in (0..WIDTH).filter(|slot| mask >> slot & 1 == 1).enumerate() {
            children[count] = node.children[slot];
        }
        mask
    }

    #[inline(always)]
    fn prefetch<T>(self, _soon: Option<&T>) {}
}

/// The AVX2 kernel: eight lanes. A value proves that [`Avx2::detect`] found the processor's features.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

/// For every 8-bit mask, the indices of its set bits.
#[cfg(target_arch = "x86_64")]
static LANES: [[u8; WIDTH]; 1 << WIDTH] = {
    let mut lanes = [[0; WIDTH]; 1 << WIDTH];
    let mut mask = 0;
    while mask < lanes.len() {
        let (mut lane, mut count) = (0, 0);
        while lane < WIDTH {
            if mask >> lane & 1 == 1 {
                lanes[mask][count] = lane as u8;
                count += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    lanes
};

#[cfg(target_arch = "x86_64")]
impl Avx2 {
    /// The kernel if this processor has AVX2, BMI1, BMI2, LZCNT and POPCNT; all with AVX2 have the others.
    #[inline]
    pub fn detect() -> Option<Self> {
        let found = std::arch::is_x86_feature_detected!("avx2")
            && std::arch::is_x86_feature_detected!("bmi1")
            && std::arch::is_x86_feature_detected!("bmi2")
            && std::arch::is_x86_feature_detected!("lzcnt")
            && std::arch::is_x86_feature_detected!("popcnt");
        found.then_some(Self(()))
    }

    /// Returns the distance at which the ray enters each box, and a mask of the boxes that it meets.
    #[inline(always)]
    fn slabs(self, node: &Node, ray: &BoxRay, t_max: f32) -> (std::arch::x86_64::__m256, usize) {
        use std::arch::x86_64::*;
        // SAFETY: `self` exists only if AVX2 was detected. Every load reads eight f32 from an array of eight.
        unsafe {
            let mut enter = _mm256_set1_ps(ray.t_min);
            let mut leave = _mm256_set1_ps(t_max);
            for axis in 0..3 {
                let origin = _mm256_set1_ps(ray.origin[axis]);
                let distance = |side: usize, inverse: f32| {
                    let planes = _mm256_loadu_ps(node.bounds[side & 1][axis].as_ptr());
                    _mm256_mul_ps(_mm256_sub_ps(planes, origin), _mm256_set1_ps(inverse))
                };
                // max and min return their second operand when either operand is NaN.
                enter = _mm256_max_ps(distance(ray.first[axis], ray.inverse[axis]), enter);
                leave = _mm256_min_ps(distance(ray.first[axis] ^ 1, ray.exit[axis]), leave);
            }
            (enter, _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(enter, leave)) as usize)
        }
    }
}

#[cfg(target_arch = "x86_64")]
impl Kernel for Avx2 {
    #[inline(always)]
    fn boxes(self, node: &Node, ray: &BoxRay, t_max: f32) -> Boxes {
        let (enter, mask) = self.slabs(node, ray, t_max);
        let mut near = [0.0; WIDTH];
        // SAFETY: `self` exists only if AVX2 was detected. The store writes eight f32 to an array of eight.
        unsafe { std::arch::x86_64::_mm256_storeu_ps(near.as_mut_ptr(), enter) };
        Boxes { near, mask: mask as u32 }
    }

    #[inline(always)]
    fn met(self, node: &Node, ray: &BoxRay, t_max: f32, children: &mut [u32; WIDTH]) -> u32 {
        use std::arch::x86_64::*;
        let (_, mask) = self.slabs(node, ray, t_max);
        let lanes = &LANES[mask & 0xff];
        // SAFETY: `self` exists only if AVX2 was detected. The first load reads eight bytes from an array of
        // eight. The second load and the store access eight u32 in arrays of eight.
        unsafe {
            let order = _mm256_cvtepu8_epi32(_mm_loadl_epi64(lanes.as_ptr().cast()));
            let all = _mm256_loadu_si256(node.children.as_ptr().cast());
            _mm256_storeu_si256(children.as_mut_ptr().cast(), _mm256_permutevar8x32_epi32(all, order));
        }
        mask as u32
    }

    #[inline(always)]
    fn prefetch<T>(self, soon: Option<&T>) {
        use std::arch::x86_64::*;
        let start = soon.map_or(std::ptr::null(), std::ptr::from_ref).cast::<i8>();
        for line in [0, 64, 128] {
            // SAFETY: a prefetch has no visible effect on memory, and no address makes it fault.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(line)) };
        }
    }
}
