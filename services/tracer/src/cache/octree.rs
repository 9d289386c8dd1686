//! Which records may cover a point.

use crate::bounds::Bounds;
use glam::Vec3;

/// Cells are not split further than this.
const DEPTH: u32 = 20;

/// An octree over a cube. A sphere is entered in the (at most eight) cells of about its size that it touches, so that the cells
/// on the way from the root to a point hold all spheres that may contain the point.
#[derive(Debug, Default, Clone)]
pub struct Octree {
    low: Vec3,
    edge: f32,
    cells: Vec<Cell>,
}

#[derive(Debug, Default, Clone)]
struct Cell {
    /// The cell of each octant, 0 for none: the root is nobody's child.
    children: [u32; 8],
    members: Vec<Member>,
}

/// A sphere in a cell, beside its neighbours there: most of those that are looked at do not contain the point, and that is found out here.
#[derive(Debug, Clone, Copy)]
pub struct Member {
    /// What it was entered under.
    pub index: u32,
    center: Vec3,
    radius: f32,
}

impl Member {
    /// Whether the sphere, of a share of its radius, may contain a point; if not, it does not, however one rounds.
    pub fn may_contain(&self, point: Vec3, share: f32) -> bool {
        self.is_within(point, self.radius * share)
    }

    fn is_within(&self, point: Vec3, distance: f32) -> bool {
        /// More than a few roundings.
        const WIDER: f32 = 1.0 + 1e-5;
        let distance = distance * WIDER;
        self.center.distance_squared(point) <= distance * distance
    }
}

impl Octree {
    /// Over a box that holds all points that will be asked for, for spheres of this radius or a larger one.
    ///
    /// The cube is a power of two times as wide as a sphere of the least radius, so that these, which are often most of all, are in
    /// cells that are just as large as they are. In a cube that fits the box, cells would be up to twice as large, and hold up to
    /// three times as many: in one frame so, and in the next, whose radii are a little smaller, otherwise.
    pub fn new(Bounds { low, high }: Bounds, least: f32) -> Self {
        // A little larger than the box, so that rounding keeps its border inside.
        let box_edge = (high - low).max_element().max(f32::MIN_POSITIVE) * 1.001;
        let mut edge = 2.0 * least;
        if !(edge.is_normal() && box_edge.is_finite()) {
            edge = box_edge;
        }
        while edge < box_edge {
            edge *= 2.0;
        }
        Self { low, edge, cells: vec![Cell::default()] }
    }

    /// Enters a sphere under an index.
    pub fn insert(&mut self, index: u32, center: Vec3, radius: f32) {
        let mut depth = 0;
        let mut edge = self.edge;
        while depth < DEPTH && edge * 0.5 >= 2.0 * radius {
            edge *= 0.5;
            depth += 1;
        }
        let member = Member { index, center, radius };
        self.descend(0, self.low, self.edge, depth, (center - radius, center + radius), member);
    }

    fn descend(&mut self, cell: u32, low: Vec3, edge: f32, depth: u32, bounds: (Vec3, Vec3), member: Member) {
        if depth == 0 {
            self.cells[cell as usize].members.push(member);
            return;
        }
        let half = edge * 0.5;
        let middle = low + half;
        for octant in 0..8u32 {
            let upper = [octant & 1 != 0, octant & 2 != 0, octant & 4 != 0];
            let touches = (0..3).all(|axis| {
                if upper[axis] { bounds.1[axis] >= middle[axis] } else { bounds.0[axis] < middle[axis] }
            });
            if !touches {
                continue;
            }
            let mut child = self.cells[cell as usize].children[octant as usize];
            if child == 0 {
                child = self.cells.len() as u32;
                self.cells.push(Cell::default());
                self.cells[cell as usize].children[octant as usize] = child;
            }
            let offset = Vec3::from(upper.map(|upper| if upper { half } else { 0.0 }));
            self.descend(child, low + offset, half, depth - 1, bounds, member);
        }
    }

    /// The spheres in the cells of a point: all that may contain it, in an order that depends on the insertions alone.
    pub fn near(&self, point: Vec3) -> impl Iterator<Item = &Member> {
        let mut cell = self.cells.first();
        let mut middle = self.low + self.edge * 0.5;
        let mut quarter = self.edge * 0.25;
        std::iter::from_fn(move || {
            let here = cell?;
            let upper = point.cmpge(middle);
            let child = here.children[upper.bitmask() as usize];
            middle += Vec3::select(upper, Vec3::splat(quarter), Vec3::splat(-quarter));
            quarter *= 0.5;
            cell = if child == 0 { None } else { self.cells.get(child as usize) };
            Some(here)
        })
        .flat_map(|cell| &cell.members)
    }

    /// Indices of the spheres that touch one, some more than once.
    pub fn touching(&self, center: Vec3, radius: f32) -> Vec<u32> {
        let mut found = Vec::new();
        if !self.cells.is_empty() {
            let around = (center - radius, center + radius);
            self.collect(0, self.low, self.edge, around, &mut |member: &Member| {
                if member.is_within(center, member.radius + radius) {
                    found.push(member.index);
                }
            });
        }
        found
    }

    fn collect(
        &self,
        cell: u32,
        low: Vec3,
        edge: f32,
        bounds: (Vec3, Vec3),
        found: &mut impl FnMut(&Member),
    ) {
        let cell = &self.cells[cell as usize];
        cell.members.iter().for_each(&mut *found);
        let half = edge * 0.5;
        for (octant, &child) in cell.children.iter().enumerate().filter(|(_, child)| **child != 0) {
            let offset = Vec3::from([1, 2, 4].map(|bit| if octant & bit != 0 { half } else { 0.0 }));
            let corner = low + offset;
            if corner.cmple(bounds.1).all() && (corner + half).cmpge(bounds.0).all() {
                self.collect(child, corner, half, bounds, found);
            }
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::random::hash;

    /// The i-th of numbers that are spread evenly from 0 to 1.
    pub fn number(i: u64) -> f32 {
        (hash(i) >> 40) as f32 / (1 << 24) as f32
    }

    /// The same of the unit cube's points.
    pub fn point(i: u64) -> Vec3 {
        Vec3::new(number(3 * i), number(3 * i + 1), number(3 * i + 2))
    }

    /// Five hundred spheres of very different sizes.
    fn spheres() -> (Vec<(Vec3, f32)>, Octree) {
        let spheres: Vec<(Vec3, f32)> =
            (0..500).map(|i| (point(i), 0.001 * 300f32.powf(number(10_000 + i)))).collect();
        let mut octree = Octree::new(Bounds { low: Vec3::ZERO, high: Vec3::ONE }, 0.001);
        for (index, (center, radius)) in spheres.iter().enumerate() {
            octree.insert(index as u32, *center, *radius);
        }
        (spheres, octree)
    }

    #[test]
    fn what_is_looked_at_does_not_depend_on_how_the_box_fits_the_spheres() {
        let looked_at = |radius: f32| {
            let mut octree = Octree::new(Bounds { low: Vec3::ZERO, high: Vec3::ONE }, radius);
            (0..2000).for_each(|index| octree.insert(index, point(u64::from(index)), radius));
            let all: usize = (5000..6000).map(|i| octree.near(point(i)).count()).sum();
            // Of spheres that are spread through a cube as many as their share of it.
            all as f64 / f64::from(radius.powi(3))
        };
        let least = looked_at(0.03);
        for radius in [0.033, 0.037, 0.042, 0.047, 0.053] {
            let ratio = looked_at(radius) / least;
            assert!((0.85..1.15).contains(&ratio), "{ratio} times as many with a radius of {radius}");
        }
    }

    #[test]
    fn every_sphere_that_contains_a_point_is_found() {
        let (spheres, octree) = spheres();
        let mut contained = 0;
        for i in 1000..3000 {
            let p = point(i);
            let near = octree.near(p).filter(|member| member.may_contain(p, 1.0));
            let near: Vec<u32> = near.map(|member| member.index).collect();
            let touching = octree.touching(p, 0.0);
            for (index, (center, radius)) in spheres.iter().enumerate() {
                if center.distance(p) < *radius {
                    contained += 1;
                    assert!(near.contains(&(index as u32)), "sphere {index} misses point {i}");
                    assert!(touching.contains(&(index as u32)), "sphere {index} misses box {i}");
                }
            }
            let mut unique = near.clone();
            unique.dedup();
            assert_eq!(unique.len(), near.len());
        }
        assert!(contained > 1000, "the test met {contained} cases only");
    }
}
