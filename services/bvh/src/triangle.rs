//! The watertight test of one ray against four triangles (Woop, Benthin and Wald 2013, "Watertight
//! Ray/Triangle Intersection"). Edges that f32 cannot decide are evaluated in f64, and a tie-breaking rule
//! decides rays exactly through an edge or a corner.

use crate::node::{GROUP, Group};
use crate::ray::{Hit, Ray};
use glam::{BVec4A, Vec4};

/// A ray prepared for the watertight test: axes permuted and sheared so that it runs along the last one.
pub(crate) struct Shear {
    axes: [usize; 3],
    origin: [f32; 3],
    shear: [f32; 3],
    t_min: f32,
}

/// Results for the four triangles of a group. Bits of `mask` mark the triangles that the ray meets.
pub(crate) struct Candidates {
    t: [f32; GROUP],
    u: [f32; GROUP],
    v: [f32; GROUP],
    pub mask: u32,
}

impl Candidates {
    #[inline(always)]
    pub fn hit(&self, group: &Group, lane: usize) -> Hit {
        Hit { t: self.t[lane], primitive: group.primitives[lane], u: self.u[lane], v: self.v[lane] }
    }
}

impl Shear {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
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
            std::mem::swap(&mut x, &mut y); // preserves the winding
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
    pub fn group(&self, group: &Group, t_max: f32) -> Candidates {
        let [x, y, z] = self.axes;
        let corner = |c: usize| {
            let along = group.corners[c][z] - self.origin[2];
            let p = (group.corners[c][x] - self.origin[0]) - self.shear[0] * along;
            let q = (group.corners[c][y] - self.origin[1]) - self.shear[1] * along;
            (p, q, along)
        };
        let ((ax, ay, az), (bx, by, bz), (cx, cy, cz)) = (corner(0), corner(1), corner(2));
        // Scaled barycentrics: twice the signed areas of the three sub-triangles, seen along the ray.
        let mut u = cx * by - cy * bx;
        let mut v = ax * cy - ay * cx;
        let mut w = bx * ay - by * ax;
        let zero = u.cmpeq(Vec4::ZERO) | v.cmpeq(Vec4::ZERO) | w.cmpeq(Vec4::ZERO);
        let mut sides = [u, v, w];
        if zero.any() {
            [u, v, w] = exact(zero, [ax, ay], [bx, by], [cx, cy], [u, v, w]);
            sides = decided([u, v, w], [ax, ay], [bx, by], [cx, cy]);
        }
        let [a, b, c] = sides;
        let negative = a.cmplt(Vec4::ZERO) | b.cmplt(Vec4::ZERO) | c.cmplt(Vec4::ZERO);
        let positive = a.cmpgt(Vec4::ZERO) | b.cmpgt(Vec4::ZERO) | c.cmpgt(Vec4::ZERO);
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

/// Decides on which side of each edge the ray passes, as a sign. A ray through an edge or a corner is treated
/// as if shifted by (ε, ε²) (Edelsbrunner and Mücke 1990, "Simulation of Simplicity"). So exactly one of two
/// adjacent triangles is hit.
#[cold]
#[inline(never)]
fn decided(sides: [Vec4; 3], [ax, ay]: [Vec4; 2], [bx, by]: [Vec4; 2], [cx, cy]: [Vec4; 2]) -> [Vec4; 3] {
    // The derivatives of the edge functions with respect to the two shifts.
    let shifted = [(cy - by, bx - cx), (ay - cy, cx - ax), (by - ay, ax - bx)];
    let zero = |value: Vec4| value.cmpeq(Vec4::ZERO);
    std::array::from_fn(|i| {
        let (first, second) = shifted[i];
        Vec4::select(zero(sides[i]), Vec4::select(zero(first), second, first), sides[i])
    })
}

/// Recomputes the scaled barycentrics u, v and w in f64, for the lanes in `zero`. Products of two f32 are
/// exact in f64, so two triangles agree about their shared edge.
#[cold]
#[inline(never)]
fn exact(
    zero: BVec4A,
    [ax, ay]: [Vec4; 2],
    [bx, by]: [Vec4; 2],
    [cx, cy]: [Vec4; 2],
    [u, v, w]: [Vec4; 3],
) -> [Vec4; 3] {
    let difference = |p: Vec4, q: Vec4, r: Vec4, s: Vec4| {
        let (p, q, r, s) = (p.as_dvec4(), q.as_dvec4(), r.as_dvec4(), s.as_dvec4());
        (p * q - r * s).as_vec4()
    };
    [
        Vec4::select(zero, difference(cx, by, cy, bx), u),
        Vec4::select(zero, difference(ax, cy, ay, cx), v),
        Vec4::select(zero, difference(bx, ay, by, ax), w),
    ]
}
