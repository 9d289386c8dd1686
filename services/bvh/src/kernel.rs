//! One ray against eight boxes: the portable kernel and the AVX2 kernel, bit for bit the same.

use crate::node::{Node, WIDTH};
use crate::ray::Ray;
use glam::{Vec3, Vec4};

/// Relative widening of a box's exit distance that makes the slab test conservative in f32: 1 + 2γ₄, γ₄ = 4ε/(1−4ε), for the
/// roundings of a reciprocal, its widening, a difference and a product (Ize 2013, "Robust BVH Ray Traversal").
pub(crate) const EXIT_SCALE: f32 = 1.0 + 4.8e-7;

/// A ray prepared for box tests.
#[derive(Clone, Copy)]
pub(crate) struct BoxRay {
    pub origin: Vec3,
    pub inverse: Vec3,
    /// The inverse, widened for the planes on which the ray leaves.
    pub exit: Vec3,
    /// For each axis, which of `Node::bounds` the ray meets first.
    pub first: [usize; 3],
    pub t_min: f32,
}

impl BoxRay {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let inverse = ray.direction.recip();
        // By the sign bit, so that a direction of −0 agrees with its inverse −∞.
        let first = inverse.to_array().map(|i| usize::from(i.is_sign_negative()));
        Self { origin: ray.origin, inverse, exit: inverse * EXIT_SCALE, first, t_min: ray.t_min }
    }
}

/// Where the ray enters each of eight boxes, and the bit mask of those that it meets before `t_max`.
pub(crate) struct Boxes {
    pub near: [f32; WIDTH],
    pub mask: u32,
}

/// A way of testing boxes. Comparisons are written so that a NaN (0 · ∞: the ray runs inside a slab's plane)
/// leaves the interval as it was: such an axis does not exclude the box.
pub(crate) trait Kernel: Copy {
    /// Tests the boxes of a node.
    fn boxes(self, node: &Node, ray: &BoxRay, t_max: f32) -> Boxes;

    /// Writes the children whose boxes the ray meets to the front of `children`, in the order of their slots, and returns
    /// the bit mask of these slots. What is behind them is left undefined.
    fn met(self, node: &Node, ray: &BoxRay, t_max: f32, children: &mut [u32; WIDTH]) -> u32;

    /// Asks for memory that may soon be read.
    fn prefetch<T>(self, soon: Option<&T>);
}

/// Two times four lanes in glam's vectors: works everywhere.
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

/// Eight lanes at once. A value of this type is the proof that the processor has what [`Avx2::detect`] asks for.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

/// For every mask of eight lanes, the indices of the lanes in it.
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
    /// The kernel, if this processor can run it: AVX2, and the bit operations that every processor with AVX2 has.
    #[inline]
    pub fn detect() -> Option<Self> {
        let found = std::arch::is_x86_feature_detected!("avx2")
            && std::arch::is_x86_feature_detected!("bmi1")
            && std::arch::is_x86_feature_detected!("bmi2")
            && std::arch::is_x86_feature_detected!("lzcnt")
            && std::arch::is_x86_feature_detected!("popcnt");
        found.then_some(Self(()))
    }

    /// Where the ray enters each box, and in which lanes it does so before it leaves.
    #[inline(always)]
    fn slabs(self, node: &Node, ray: &BoxRay, t_max: f32) -> (std::arch::x86_64::__m256, usize) {
        use std::arch::x86_64::*;
        // SAFETY: `self` exists only where AVX2 was detected; every load is of eight f32 from an array of eight.
        unsafe {
            let mut enter = _mm256_set1_ps(ray.t_min);
            let mut leave = _mm256_set1_ps(t_max);
            for axis in 0..3 {
                let origin = _mm256_set1_ps(ray.origin[axis]);
                let distance = |side: usize, inverse: f32| {
                    let planes = _mm256_loadu_ps(node.bounds[side & 1][axis].as_ptr());
                    _mm256_mul_ps(_mm256_sub_ps(planes, origin), _mm256_set1_ps(inverse))
                };
                // max and min return their second operand when either is NaN.
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
        // SAFETY: `self` exists only where AVX2 was detected; the store is of eight f32 to an array of eight.
        unsafe { std::arch::x86_64::_mm256_storeu_ps(near.as_mut_ptr(), enter) };
        Boxes { near, mask: mask as u32 }
    }

    #[inline(always)]
    fn met(self, node: &Node, ray: &BoxRay, t_max: f32, children: &mut [u32; WIDTH]) -> u32 {
        use std::arch::x86_64::*;
        let (_, mask) = self.slabs(node, ray, t_max);
        let lanes = &LANES[mask & 0xff];
        // SAFETY: `self` exists only where AVX2 was detected; eight bytes are read from an array of eight, eight u32 are read
        // from and written to arrays of eight.
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
            // SAFETY: a prefetch reads nothing that the program could see, and no address makes it fault.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(line)) };
        }
    }
}
