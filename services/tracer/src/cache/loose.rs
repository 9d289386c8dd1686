//! A loose octree, which finds the spheres that touch another sphere.

use super::octree::{Cube, DEPTH};
use super::spheres::{List, Lists, Sphere, WIDER};
use crate::bounds::Bounds;
use glam::Vec3;

/// Cells are at least this many times wider than the radii of their spheres. With smaller cells, visiting
/// them would cost more than is saved by considering fewer spheres.
const WIDTH: f32 = 4.0;

/// A loose octree: each sphere is stored once, in the cell of about its size that contains its centre.
#[derive(Debug, Default, Clone)]
pub struct LooseOctree {
    cube: Cube,
    cells: Vec<Cell>,
    spheres: Lists,
}

#[derive(Debug, Clone, Copy)]
struct Cell {
    /// The child cell of each octant. 0 means none, because the root is never a child.
    children: [u32; 8],
    /// Bounding box of the centres of all spheres in the cell and below it.
    centers: Bounds,
    /// The largest radius of these spheres.
    largest: f32,
    members: List,
}

impl Cell {
    const EMPTY: Self = Self { children: [0; 8], centers: Bounds::EMPTY, largest: 0.0, members: List::EMPTY };
}

impl LooseOctree {
    pub fn over(cube: Cube) -> Self {
        Self { cube, cells: vec![Cell::EMPTY], spheres: Lists::default() }
    }

    /// Adds a sphere.
    pub fn insert(&mut self, sphere: Sphere) {
        let Sphere { center, radius, .. } = sphere;
        let Cube { mut low, mut edge } = self.cube;
        let (mut here, mut depth) = (0, 0);
        loop {
            let next = self.cells.len() as u32;
            let cell = &mut self.cells[here];
            cell.centers = cell.centers.union(Bounds { low: center, high: center });
            cell.largest = cell.largest.max(radius);
            edge *= 0.5;
            if depth == DEPTH || edge < WIDTH * radius {
                return self.spheres.push(&mut cell.members, sphere);
            }
            let upper = center.cmpge(low + edge);
            low += Vec3::select(upper, Vec3::splat(edge), Vec3::ZERO);
            let child = &mut cell.children[upper.bitmask() as usize];
            if *child == 0 {
                *child = next;
                here = next as usize;
                self.cells.push(Cell::EMPTY);
            } else {
                here = *child as usize;
            }
            depth += 1;
        }
    }

    /// Calls `each` once per sphere that may touch the given one. Only the insertions determine the order.
    pub fn touching(&self, center: Vec3, radius: f32, mut each: impl FnMut(u32)) {
        if let Some(root) = self.cells.first() {
            self.visit(root, center, radius, &mut each);
        }
    }

    fn visit(&self, cell: &Cell, center: Vec3, radius: f32, each: &mut impl FnMut(u32)) {
        let beside = (cell.centers.low - center).max(center - cell.centers.high).max(Vec3::ZERO);
        let farthest = (cell.largest + radius) * WIDER;
        if beside.length_squared() > farthest * farthest {
            return;
        }
        self.spheres
            .blocks(cell.members)
            .for_each(|block| block.touching(center, radius).for_each(&mut *each));
        for &child in cell.children.iter().filter(|child| **child != 0) {
            self.visit(&self.cells[child as usize], center, radius, each);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::octree::tests::{point, spheres, unit_cube};

    #[test]
    fn every_sphere_that_touches_another_is_found_once() {
        let spheres = spheres();
        let mut octree = LooseOctree::over(unit_cube(0.001));
        spheres.iter().for_each(|sphere| octree.insert(*sphere));
        let mut touched = 0;
        // Some centres are outside the octree's cube.
        let others = (1000..2000).map(|i| 2.0 * point(i) - 0.5);
        for (sphere, center) in spheres.iter().cycle().zip(others) {
            let mut found = Vec::new();
            octree.touching(center, sphere.radius, |index| found.push(index));
            found.sort_unstable();
            let touches = |other: &&Sphere| other.center.distance(center) <= sphere.radius + other.radius;
            let expected: Vec<u32> = spheres.iter().filter(touches).map(|other| other.index).collect();
            assert_eq!(found, expected, "around {center}");
            touched += found.len();
        }
        assert!(touched > 1000, "the test met {touched} cases only");
    }
}
