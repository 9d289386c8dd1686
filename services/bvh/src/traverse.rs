//! The two queries: the closest hit, and whether there is any.

use crate::kernel::{BoxRay, Boxes, Kernel, Portable};
use crate::node::{Bvh, Group, LEAF};
use crate::ray::{Entry, Hit, Ray, Traversal};
use glam::{BVec4A, Vec4};

impl Bvh {
    /// The hit of smallest `t` in (`t_min`, `t_max`] that `keep` accepts; of equal ones, the lowest triangle index.
    /// `keep` is asked for every hit that would be the closest so far, so it must depend on the hit alone.
    pub fn closest(&self, ray: &Ray, keep: impl Fn(&Hit) -> bool, steps: &mut Traversal) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if let Some(kernel) = crate::kernel::Avx2::detect() {
            // SAFETY: the kernel's existence proves that the processor has AVX2.
            return unsafe { closest_avx2(self, kernel, ray, keep, steps) };
        }
        closest(self, Portable, ray, keep, steps)
    }

    /// Whether anything that `keep` accepts lies at `t` in (`t_min`, `t_max`].
    pub fn any(&self, ray: &Ray, keep: impl Fn(&Hit) -> bool, steps: &mut Traversal) -> bool {
        #[cfg(target_arch = "x86_64")]
        if let Some(kernel) = crate::kernel::Avx2::detect() {
            // SAFETY: the kernel's existence proves that the processor has AVX2.
            return unsafe { any_avx2(self, kernel, ray, keep, steps) };
        }
        any(self, Portable, ray, keep, steps)
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn closest_avx2(
    bvh: &Bvh,
    kernel: crate::kernel::Avx2,
    ray: &Ray,
    keep: impl Fn(&Hit) -> bool,
    steps: &mut Traversal,
) -> Option<Hit> {
    closest(bvh, kernel, ray, keep, steps)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn any_avx2(
    bvh: &Bvh,
    kernel: crate::kernel::Avx2,
    ray: &Ray,
    keep: impl Fn(&Hit) -> bool,
    steps: &mut Traversal,
) -> bool {
    any(bvh, kernel, ray, keep, steps)
}

#[inline(always)]
fn closest<K: Kernel>(
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
    let mut t_max = ray.t_max;
    let stack = &mut steps.stack;
    stack.clear();
    let mut current = 0;
    loop {
        if current & LEAF == 0 {
            nodes += 1;
            let node = &bvh.nodes[current as usize];
            let Boxes { near, mut mask } = kernel.boxes(node, &boxes, t_max);
            if mask != 0 {
                let slot = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let mut nearest = Entry { near: near[slot], child: node.children[slot] };
                if mask != 0 {
                    // Several children: the nearest goes on at once, the others wait, the farthest at the bottom.
                    let base = stack.len();
                    while mask != 0 {
                        let slot = mask.trailing_zeros() as usize;
                        mask &= mask - 1;
                        let mut entry = Entry { near: near[slot], child: node.children[slot] };
                        if entry.near < nearest.near {
                            std::mem::swap(&mut entry, &mut nearest);
                        }
                        let mut at = stack.len();
                        stack.push(entry);
                        while at > base && stack[at - 1].near < entry.near {
                            stack[at] = stack[at - 1];
                            at -= 1;
                        }
                        stack[at] = entry;
                    }
                }
                current = nearest.child;
                continue;
            }
        } else {
            let group = &bvh.groups[(current & !LEAF) as usize];
            triangles += 4;
            let candidates = shear.group(group, t_max);
            let mut mask = candidates.mask;
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let hit = candidates.hit(group, lane);
                let closer = match best {
                    Some(b) => hit.t < b.t || (hit.t == b.t && hit.primitive < b.primitive),
                    None => hit.t <= t_max,
                };
                if closer && keep(&hit) {
                    t_max = hit.t;
                    best = Some(hit);
                }
            }
        }
        // A subtree that begins exactly at the best hit may hold an equal one of lower index.
        current = loop {
            match stack.pop() {
                Some(entry) if entry.near <= t_max => break entry.child,
                Some(_) => {}
                None => {
                    steps.nodes += nodes;
                    steps.triangles += triangles;
                    return best;
                }
            }
        };
    }
}

#[inline(always)]
fn any<K: Kernel>(
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
    let stack = &mut steps.stack;
    stack.clear();
    let mut current = 0;
    let found = loop {
        if current & LEAF == 0 {
            nodes += 1;
            let node = &bvh.nodes[current as usize];
            let Boxes { near, mut mask } = kernel.boxes(node, &boxes, ray.t_max);
            while mask != 0 {
                let slot = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                stack.push(Entry { near: near[slot], child: node.children[slot] });
            }
        } else {
            let group = &bvh.groups[(current & !LEAF) as usize];
            triangles += 4;
            let candidates = shear.group(group, ray.t_max);
            let mut mask = candidates.mask;
            let mut found = false;
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                found |= keep(&candidates.hit(group, lane));
            }
            if found {
                break true;
            }
        }
        match stack.pop() {
            Some(entry) => current = entry.child,
            None => break false,
        }
    };
    steps.nodes += nodes;
    steps.triangles += triangles;
    found
}

/// A ray prepared for the watertight triangle test: axes permuted so that the ray runs mainly along the last,
/// then sheared so that it runs along it exactly (Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection").
struct Shear {
    axes: [usize; 3],
    origin: [f32; 3],
    shear: [f32; 3],
    t_min: f32,
}

/// The lanes of a group that the ray meets.
struct Candidates {
    t: [f32; 4],
    u: [f32; 4],
    v: [f32; 4],
    mask: u32,
}

impl Candidates {
    #[inline(always)]
    fn hit(&self, group: &Group, lane: usize) -> Hit {
        Hit { t: self.t[lane], primitive: group.primitives[lane], u: self.u[lane], v: self.v[lane] }
    }
}

impl Shear {
    #[inline(always)]
    fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let size = ray.direction.abs();
        let z = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if d[z] < 0.0 {
            std::mem::swap(&mut x, &mut y); // keeps the winding
        }
        let o = ray.origin.to_array();
        Self {
            axes: [x, y, z],
            origin: [o[x], o[y], o[z]],
            shear: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]],
            t_min: ray.t_min,
        }
    }

    #[inline(always)]
    fn group(&self, group: &Group, t_max: f32) -> Candidates {
        let [x, y, z] = self.axes;
        let corner = |c: usize| {
            let along = group.corners[c][z] - self.origin[2];
            let p = (group.corners[c][x] - self.origin[0]) - self.shear[0] * along;
            let q = (group.corners[c][y] - self.origin[1]) - self.shear[1] * along;
            (p, q, along)
        };
        let ((ax, ay, az), (bx, by, bz), (cx, cy, cz)) = (corner(0), corner(1), corner(2));
        // Scaled barycentrics: twice the signed areas of the three parts as seen along the ray.
        let mut u = cx * by - cy * bx;
        let mut v = ax * cy - ay * cx;
        let mut w = bx * ay - by * ax;
        let zero = u.cmpeq(Vec4::ZERO) | v.cmpeq(Vec4::ZERO) | w.cmpeq(Vec4::ZERO);
        if zero.any() {
            let exact = |p: Vec4, q: Vec4, r: Vec4, s: Vec4| {
                let (p, q, r, s) = (p.as_dvec4(), q.as_dvec4(), r.as_dvec4(), s.as_dvec4());
                (p * q - r * s).as_vec4()
            };
            u = Vec4::select(zero, exact(cx, by, cy, bx), u);
            v = Vec4::select(zero, exact(ax, cy, ay, cx), v);
            w = Vec4::select(zero, exact(bx, ay, by, ax), w);
        }
        let negative = u.cmplt(Vec4::ZERO) | v.cmplt(Vec4::ZERO) | w.cmplt(Vec4::ZERO);
        let positive = u.cmpgt(Vec4::ZERO) | v.cmpgt(Vec4::ZERO) | w.cmpgt(Vec4::ZERO);
        let determinant = u + v + w;
        let inside: BVec4A = !(negative & positive) & determinant.cmpne(Vec4::ZERO);
        if !inside.any() {
            let none = [0.0; 4];
            return Candidates { t: none, u: none, v: none, mask: 0 };
        }
        let inverse = determinant.recip();
        let t = (u * az + v * bz + w * cz) * self.shear[2] * inverse;
        let hit = inside & t.cmpgt(Vec4::splat(self.t_min)) & t.cmple(Vec4::splat(t_max));
        Candidates {
            t: t.to_array(),
            u: (v * inverse).to_array(),
            v: (w * inverse).to_array(),
            mask: hit.bitmask(),
        }
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;
    use crate::kernel::Avx2;
    use glam::Vec3;

    /// A soup of triangles and rays from a counter, so that every run tests the same.
    fn soup() -> (Vec<Vec3>, Vec<[u32; 3]>, Vec<Ray>) {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
            ((word >> 22) ^ word) as f32 / u32::MAX as f32 - 0.5
        };
        let mut point = |size: f32| Vec3::new(next(), next(), next()) * size;
        let mut positions = Vec::new();
        for _ in 0..500 {
            let centre = point(10.0);
            for _ in 0..3 {
                positions.push(centre + point(1.0));
            }
        }
        let triangles = (0..500).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mut rays: Vec<Ray> = (0..2000).map(|_| Ray::new(point(12.0), point(1.0))).collect();
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let mut direction = [0.0, -0.0, 0.0];
                direction[axis] = sign;
                rays.extend((0..200).map(|_| Ray::new(point(12.0), Vec3::from(direction))));
            }
        }
        (positions, triangles, rays)
    }

    #[test]
    fn both_kernels_return_the_same_bits_and_counts() {
        let Some(avx2) = Avx2::detect() else {
            println!("skipped: no AVX2 here");
            return;
        };
        let (positions, triangles, rays) = soup();
        let bvh = Bvh::build(&positions, &triangles);
        let (mut a, mut b) = (Traversal::default(), Traversal::default());
        for ray in &rays {
            let one = closest(&bvh, Portable, ray, |_| true, &mut a);
            let other = closest(&bvh, avx2, ray, |_| true, &mut b);
            assert_eq!(one, other, "{ray:?}");
            assert_eq!(any(&bvh, Portable, ray, |_| true, &mut a), one.is_some());
            assert_eq!(any(&bvh, avx2, ray, |_| true, &mut b), one.is_some());
        }
        assert_eq!((a.nodes, a.triangles), (b.nodes, b.triangles));
    }

    #[test]
    fn the_tree_finds_what_testing_every_triangle_finds() {
        let (positions, triangles, rays) = soup();
        let bvh = Bvh::build(&positions, &triangles);
        let mut hits = 0;
        for ray in &rays {
            let shear = Shear::new(ray);
            let mut expected: Option<Hit> = None;
            for (i, t) in triangles.iter().enumerate() {
                let corners = t.map(|v| positions[v as usize].to_array().map(Vec4::splat));
                let group = Group { corners, primitives: [i as u32; 4] };
                let candidates = shear.group(&group, ray.t_max);
                if candidates.mask & 1 == 1 {
                    let hit = candidates.hit(&group, 0);
                    if expected.is_none_or(|e| hit.t < e.t) {
                        expected = Some(hit);
                    }
                }
            }
            hits += usize::from(expected.is_some());
            assert_eq!(bvh.closest(ray, |_| true, &mut Traversal::default()), expected);
        }
        assert!(hits > rays.len() / 10, "the soup must be hit often enough to prove something: {hits}");
    }
}
