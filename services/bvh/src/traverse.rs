//! The closest-hit and any-hit queries: depth-first with an explicit stack. Each is generic over the box test
//! ([`Kernel`]), and compiled a second time with AVX2.

use crate::kernel::{BoxRay, Boxes, EXIT_SCALE, Kernel, Portable};
use crate::node::{Bvh, END, LEAF, Node, WIDTH};
use crate::ray::{Entry, Hit, Ray, Traversal};
use crate::triangle::Shear;

impl Bvh {
    /// The hit with the smallest `t` in (`t_min`, `t_max`] that `keep` accepts. Ties go to the lowest
    /// triangle index. `keep` is called for each hit that would be the closest so far, and must depend only
    /// on it.
    pub fn closest(&self, ray: &Ray, keep: impl Fn(&Hit) -> bool, steps: &mut Traversal) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if let Some(kernel) = crate::kernel::Avx2::detect() {
            // SAFETY: the kernel's existence proves that the processor has these features.
            return unsafe { closest_avx2(self, kernel, ray, keep, steps) };
        }
        closest(self, Portable, ray, keep, steps)
    }

    /// Returns `true` if a hit that `keep` accepts lies at `t` in (`t_min`, `t_max`].
    pub fn any(&self, ray: &Ray, keep: impl Fn(&Hit) -> bool, steps: &mut Traversal) -> bool {
        #[cfg(target_arch = "x86_64")]
        if let Some(kernel) = crate::kernel::Avx2::detect() {
            // SAFETY: the kernel's existence proves that the processor has these features.
            return unsafe { any_avx2(self, kernel, ray, keep, steps) };
        }
        any(self, Portable, ray, keep, steps)
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
pub(crate) fn closest_avx2(
    bvh: &Bvh,
    kernel: crate::kernel::Avx2,
    ray: &Ray,
    keep: impl Fn(&Hit) -> bool,
    steps: &mut Traversal,
) -> Option<Hit> {
    closest(bvh, kernel, ray, keep, steps)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
pub(crate) fn any_avx2(
    bvh: &Bvh,
    kernel: crate::kernel::Avx2,
    ray: &Ray,
    keep: impl Fn(&Hit) -> bool,
    steps: &mut Traversal,
) -> bool {
    any(bvh, kernel, ray, keep, steps)
}

#[inline(always)]
pub(crate) fn closest<K: Kernel>(
    bvh: &Bvh,
    kernel: K,
    ray: &Ray,
    keep: impl Fn(&Hit) -> bool,
    steps: &mut Traversal,
) -> Option<Hit> {
    if bvh.nodes.is_empty() {
        return None;
    }
    let boxes = BoxRay::new(ray);
    let shear = Shear::new(ray);
    let (mut nodes, mut triangles) = (0, 0);
    let mut best: Option<Hit> = None;
    let mut t_max = finite(ray.t_max);
    let mut cull = t_max * EXIT_SCALE;
    let stack = grown(&mut steps.stack, bvh.waiting());
    stack[0] = Entry { near: f32::NEG_INFINITY, child: END };
    let mut top = 1;
    let mut current = 0;
    loop {
        if current & LEAF == 0 {
            nodes += 1;
            let node = &bvh.nodes[current as usize];
            let met = kernel.boxes(node, &boxes, cull);
            if met.mask != 0 {
                current = nearest(bvh, kernel, node, met, stack, &mut top);
                continue;
            }
        } else if current == END {
            steps.nodes += nodes;
            steps.triangles += triangles;
            return best;
        } else {
            let group = &bvh.groups[(current & !LEAF) as usize];
            triangles += 4;
            let candidates = shear.group(group, t_max);
            let mut mask = candidates.mask;
            while mask != 0 {
                let hit = candidates.hit(group, pop_lowest_bit(&mut mask));
                let closer = match best {
                    Some(b) => hit.t < b.t || (hit.t == b.t && hit.primitive < b.primitive),
                    None => true,
                };
                if closer && keep(&hit) {
                    t_max = hit.t;
                    // A subtree that begins at the best hit may hold an equal hit with a lower index.
                    cull = t_max * EXIT_SCALE;
                    best = Some(hit);
                }
            }
        }
        current = loop {
            top -= 1;
            let entry = stack[top];
            if entry.near <= cull {
                break entry.child;
            }
        };
    }
}

/// Returns the nearest child that the ray meets, the later slot on ties, and pushes the others, farthest
/// first. At least one child must be met.
#[inline(always)]
fn nearest<K: Kernel>(
    bvh: &Bvh,
    kernel: K,
    node: &Node,
    Boxes { near, mut mask }: Boxes,
    stack: &mut [Entry],
    top: &mut usize,
) -> u32 {
    let mut next = || {
        let slot = pop_lowest_bit(&mut mask);
        (Entry { near: near[slot], child: node.children[slot] }, mask == 0)
    };
    let (first, last) = next();
    if last {
        return first.child;
    }
    let (second, mut last) = next();
    prefetch_child(bvh, kernel, first.child);
    prefetch_child(bvh, kernel, second.child);
    let (first, second) = if second.near <= first.near { (second, first) } else { (first, second) };
    let bottom = *top;
    stack[bottom] = second;
    *top += 1;
    if last {
        return first.child;
    }
    stack[*top] = first;
    *top += 1;
    while !last {
        let entry;
        (entry, last) = next();
        prefetch_child(bvh, kernel, entry.child);
        let mut at = *top;
        while at > bottom && stack[at - 1].near < entry.near {
            stack[at] = stack[at - 1];
            at -= 1;
        }
        stack[at] = entry;
        *top += 1;
    }
    *top -= 1;
    stack[*top].child
}

/// Limits `t_max` to finite values. An infinite `t` is no hit, but comes from a nearly edge-on triangle.
#[inline(always)]
fn finite(t_max: f32) -> f32 {
    t_max.min(f32::MAX)
}

/// Removes the lowest set bit and returns its index.
#[inline(always)]
fn pop_lowest_bit(mask: &mut u32) -> usize {
    let index = mask.trailing_zeros() as usize;
    *mask &= *mask - 1;
    index
}

/// Prefetches a child while the other children are still being sorted.
#[inline(always)]
fn prefetch_child<K: Kernel>(bvh: &Bvh, kernel: K, child: u32) {
    if child & LEAF == 0 {
        kernel.prefetch(bvh.nodes.get(child as usize));
    } else {
        kernel.prefetch(bvh.groups.get((child & !LEAF) as usize));
    }
}

/// The scratch vector as a slice, grown to at least `length` entries.
#[inline(always)]
fn grown<T: Copy + Default>(scratch: &mut Vec<T>, length: usize) -> &mut [T] {
    if scratch.len() < length {
        scratch.resize(length, T::default());
    }
    scratch
}

#[inline(always)]
pub(crate) fn any<K: Kernel>(
    bvh: &Bvh,
    kernel: K,
    ray: &Ray,
    keep: impl Fn(&Hit) -> bool,
    steps: &mut Traversal,
) -> bool {
    if bvh.nodes.is_empty() {
        return false;
    }
    let boxes = BoxRay::new(ray);
    let shear = Shear::new(ray);
    let (mut nodes, mut triangles) = (0, 0);
    let t_max = finite(ray.t_max);
    let cull = t_max * EXIT_SCALE;
    let stack = grown(&mut steps.children, bvh.waiting());
    stack[0] = END;
    let mut top = 1;
    let mut current = 0;
    let found = loop {
        if current & LEAF == 0 {
            nodes += 1;
            let node = &bvh.nodes[current as usize];
            let Some(free) = stack[top..].first_chunk_mut::<WIDTH>() else {
                unreachable!("Bvh::waiting leaves room for the children of one more node");
            };
            let met = kernel.met(node, &boxes, cull, free);
            if met != 0 {
                // The last child has the highest priority. Read it from the node: the copy just written is
                // not available yet.
                top += met.count_ones() as usize - 1;
                current = node.children[(u32::BITS - 1 - met.leading_zeros()) as usize];
                continue;
            }
        } else if current == END {
            break false;
        } else {
            let group = &bvh.groups[(current & !LEAF) as usize];
            triangles += 4;
            let candidates = shear.group(group, t_max);
            let mut mask = candidates.mask;
            let mut found = false;
            while mask != 0 {
                found |= keep(&candidates.hit(group, pop_lowest_bit(&mut mask)));
            }
            if found {
                break true;
            }
        }
        top -= 1;
        current = stack[top];
    };
    steps.nodes += nodes;
    steps.triangles += triangles;
    found
}
