//! An octree that finds the spheres that contain a point.

use super::spheres::{Block, List, Lists, Sphere, WIDER};
use crate::bounds::Bounds;
use glam::Vec3;

/// Largest depth of a cell.
pub const DEPTH: u32 = 20;

/// Smallest edge of the cells that hold a sphere, in radii. With two radii, three times as many spheres of the deeper
/// levels would have to be looked at.
const CELL: f32 = 1.0;

/// More than the borders of cells differ by, relative to their coordinates: a rounding error for each of `DEPTH` steps.
const ROUNDING: f32 = 2.0 * DEPTH as f32 * f32::EPSILON;

/// An octree over a cube. A sphere is stored in all cells of about its size that it touches. So the path to a point
/// holds all spheres that may contain it.
#[derive(Debug, Default, Clone)]
pub struct Octree {
    cube: Cube,
    cells: Vec<Cell>,
    spheres: Lists,
}

/// The cube that an octree covers, metres.
#[derive(Debug, Default, Clone, Copy)]
pub struct Cube {
    pub low: Vec3,
    pub edge: f32,
}

#[derive(Debug, Clone, Copy)]
struct Cell {
    /// The child cell of each octant. 0 means none, because the root is never a child.
    children: [u32; 8],
    members: List,
}

impl Cell {
    const EMPTY: Self = Self { children: [0; 8], members: List::EMPTY };
}

impl Cube {
    /// A cube over a box that contains all query points, for spheres of radius `least` or larger. Its edge is
    /// a power of two times the smallest sphere's diameter, so that the smallest spheres, often the majority,
    /// get cells of their size. A tight cube could hold three times as many spheres per cell.
    pub fn over(Bounds { low, high }: Bounds, least: f32) -> Self {
        // Slightly larger than the box, so that rounding keeps its border inside.
        let box_edge = (high - low).max_element().max(f32::MIN_POSITIVE) * 1.001;
        let mut edge = 2.0 * least;
        if !(edge.is_normal() && box_edge.is_finite()) {
            edge = box_edge;
        }
        while edge < box_edge {
            edge *= 2.0;
        }
        Self { low, edge }
    }
}

impl Octree {
    pub fn over(cube: Cube) -> Self {
        Self { cube, cells: vec![Cell::EMPTY], spheres: Lists::default() }
    }

    /// Adds a sphere.
    pub fn insert(&mut self, sphere: Sphere) {
        let Sphere { center, radius, .. } = sphere;
        let Cube { low, mut edge } = self.cube;
        let mut depth = 0;
        while depth < DEPTH && edge * 0.5 >= CELL * radius {
            edge *= 0.5;
            depth += 1;
        }
        self.descend(0, low, self.cube.edge, depth, (center - radius, center + radius), sphere);
    }

    fn descend(&mut self, cell: u32, low: Vec3, edge: f32, depth: u32, around: (Vec3, Vec3), sphere: Sphere) {
        if depth == 0 {
            return self.spheres.push(&mut self.cells[cell as usize].members, sphere);
        }
        let half = edge * 0.5;
        let middle = low + half;
        let (lower, upper) = (around.0.cmplt(middle).bitmask(), around.1.cmpge(middle).bitmask());
        for octant in (0..8u32).filter(|octant| octant & !upper == 0 && !octant & !lower & 7 == 0) {
            let offset = Vec3::from([1, 2, 4].map(|bit| if octant & bit != 0 { half } else { 0.0 }));
            let corner = low + offset;
            // Borders of cells are rounded, here and in `near`.
            let reach = sphere.radius * WIDER + ROUNDING * (corner.abs().max_element() + self.cube.edge);
            if sphere.center.clamp(corner, corner + half).distance(sphere.center) > reach {
                continue;
            }
            let mut child = self.cells[cell as usize].children[octant as usize];
            if child == 0 {
                child = self.cells.len() as u32;
                self.cells.push(Cell::EMPTY);
                self.cells[cell as usize].children[octant as usize] = child;
            }
            self.descend(child, corner, half, depth - 1, around, sphere);
        }
    }

    /// The spheres in the cells that contain a point, in an order that only the insertions determine.
    pub fn near(&self, point: Vec3) -> impl Iterator<Item = &Block> {
        let mut cell = self.cells.first();
        let mut middle = self.cube.low + self.cube.edge * 0.5;
        let mut quarter = self.cube.edge * 0.25;
        std::iter::from_fn(move || {
            let here = cell?;
            let upper = point.cmpge(middle);
            let child = here.children[upper.bitmask() as usize];
            middle += Vec3::select(upper, Vec3::splat(quarter), Vec3::splat(-quarter));
            quarter *= 0.5;
            cell = if child == 0 { None } else { self.cells.get(child as usize) };
            Some(here.members)
        })
        .flat_map(|members| self.spheres.blocks(members))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::cache::spheres::SETS;
    use crate::random::hash;

    /// The i-th of a set of numbers spread evenly over [0, 1).
    pub fn number(i: u64) -> f32 {
        (hash(i) >> 40) as f32 / (1 << 24) as f32
    }

    /// The i-th of a set of points spread evenly over the unit cube.
    pub fn point(i: u64) -> Vec3 {
        Vec3::new(number(3 * i), number(3 * i + 1), number(3 * i + 2))
    }

    /// The unit cube, for spheres of radius `least` or larger.
    pub fn unit_cube(least: f32) -> Cube {
        Cube::over(Bounds { low: Vec3::ZERO, high: Vec3::ONE }, least)
    }

    /// Five hundred spheres with radii from 0.001 to 0.3.
    pub fn spheres() -> Vec<Sphere> {
        let radius = |i: u32| 0.001 * 300f32.powf(number(10_000 + u64::from(i)));
        let sets = |i: u32| (hash(u64::from(i)) & 0x3f) as u8;
        let sphere =
            |i: u32| Sphere { index: i, center: point(u64::from(i)), radius: radius(i), sets: sets(i) };
        (0..500).map(sphere).collect()
    }

    #[test]
    fn what_is_looked_at_does_not_depend_on_how_the_box_fits_the_spheres() {
        let looked_at = |radius: f32| {
            let mut octree = Octree::over(unit_cube(radius));
            let sphere = |index: u32| Sphere { index, center: point(u64::from(index)), radius, sets: 1 };
            (0..2000).for_each(|index| octree.insert(sphere(index)));
            let all: u64 = (5000..6000).flat_map(|i| octree.near(point(i))).map(|block| block.count(0)).sum();
            // For spheres spread evenly through the cube, the count should be proportional to their volume.
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
        found_at(Vec3::ZERO, 0.001);
    }

    /// Coordinates are rounded to two millimetres there.
    #[test]
    fn spheres_far_from_the_origin_are_found() {
        found_at(Vec3::new(20_000.0, -20_000.0, 9_000.0), 0.05);
    }

    fn found_at(offset: Vec3, least: f32) {
        let point = |i: u64| point(i) + offset;
        let sphere = |sphere: Sphere| Sphere {
            center: sphere.center + offset,
            radius: sphere.radius.max(least),
            ..sphere
        };
        let spheres: Vec<Sphere> = spheres().into_iter().map(sphere).collect();
        let cube = Cube::over(Bounds { low: offset, high: Vec3::ONE + offset }, least);
        let mut octree = Octree::over(cube);
        spheres.iter().for_each(|sphere| octree.insert(*sphere));
        let mut contained = 0;
        for i in 1000..3000 {
            let p = point(i);
            let set = i as usize % SETS;
            let near: Vec<u32> = octree.near(p).flat_map(|block| block.holding(set, p)).collect();
            for Sphere { index, center, radius, sets } in &spheres {
                let wanted = sets >> set & 1 == 1;
                if wanted && center.distance(p) < *radius {
                    contained += 1;
                    assert!(near.contains(index), "sphere {index} misses point {i}");
                }
                assert!(wanted || !near.contains(index), "sphere {index} is of another set");
            }
            let mut unique = near.clone();
            unique.dedup();
            assert_eq!(unique.len(), near.len());
        }
        assert!(contained > 1000, "the test met {contained} cases only");
    }
}
