//! Finds records by distance, and orders them along a space-filling curve.

use super::record::Planned;
use crate::bounds::Bounds;
use glam::Vec3;

/// Bits of a position along each axis. A cell's edge is about a thousandth of the records' extent.
const BITS: u32 = 10;

/// Number of records per block.
const TOGETHER: usize = 32;

/// Cells of a box, numbered along the Morton curve.
pub struct Cells {
    low: Vec3,
    scale: f32,
}

impl Cells {
    /// Cells of the bounding box of some records.
    pub fn around(records: &[Planned]) -> Self {
        let bounds = Bounds::of(records.iter().map(|planned| planned.site.position));
        let extent = (bounds.high - bounds.low).max_element().max(f32::MIN_POSITIVE);
        Self { low: bounds.low, scale: ((1 << BITS) - 1) as f32 / extent }
    }

    /// Number of the cell that contains a position of the box. It is below [`Self::COUNT`].
    pub fn number(&self, position: Vec3) -> u64 {
        let cell = ((position - self.low) * self.scale).to_array().map(|coordinate| coordinate as u64);
        (0..BITS).rev().fold(0, |code, bit| cell.iter().fold(code, |code, c| code << 1 | c >> bit & 1))
    }

    /// Number of cells, 2³⁰.
    pub const COUNT: u64 = 1 << (3 * BITS);
}

/// Positions of records, in blocks of nearby records. See [`super::index`] for those that may cover a site.
#[derive(Debug, Clone, Default)]
pub struct Places(Vec<Block>);

#[derive(Debug, Clone)]
struct Block {
    bounds: Bounds,
    /// Positions by axis. Unused entries are NaN, which is near nothing.
    positions: [[f32; TOGETHER]; 3],
    indices: [u32; TOGETHER],
}

impl Places {
    /// The positions of all given records.
    pub fn of(records: &[Planned]) -> Self {
        let cells = Cells::around(records);
        let mut order: Vec<u32> = (0..records.len() as u32).collect();
        order.sort_by_cached_key(|&index| cells.number(records[index as usize].site.position));
        let block = |members: &[u32]| {
            let mut block =
                Block { bounds: Bounds::EMPTY, positions: [[f32::NAN; TOGETHER]; 3], indices: [0; TOGETHER] };
            for (place, &index) in members.iter().enumerate() {
                let position = records[index as usize].site.position;
                block.bounds = block.bounds.union(Bounds { low: position, high: position });
                (0..3).for_each(|axis| block.positions[axis][place] = position[axis]);
                block.indices[place] = index;
            }
            block
        };
        Self(order.chunks(TOGETHER).map(block).collect())
    }

    /// Indices of the records within `distance` of a point, each once, in any order. Rounding may add some.
    pub fn within(&self, distance: f32, point: Vec3) -> impl Iterator<Item = u32> {
        /// Larger than a few rounding errors.
        const WIDER: f32 = 1.0 + 1e-5;
        let farthest = (distance * WIDER).powi(2);
        let is_near = move |block: &&Block| {
            let beside = (block.bounds.low - point).max(point - block.bounds.high).max(Vec3::ZERO);
            beside.length_squared() <= farthest
        };
        self.0.iter().filter(is_near).flat_map(move |block| {
            let [x, y, z] = &block.positions;
            let squares: [f32; TOGETHER] = std::array::from_fn(|i| {
                (x[i] - point.x).powi(2) + (y[i] - point.y).powi(2) + (z[i] - point.z).powi(2)
            });
            (0..TOGETHER).filter(move |&i| squares[i] <= farthest).map(|i| block.indices[i])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::Site;
    use crate::cache::octree::tests::{number, point};

    fn records(count: u64) -> Vec<Planned> {
        (0..count).map(|i| Planned::in_the_open(Site::bare(point(i), Vec3::Y), 1.0)).collect()
    }

    #[test]
    fn all_records_within_a_distance_are_found_each_once() {
        let mut all = 0;
        for count in [0, 1, 31, 32, 33, 500] {
            let records = records(count);
            let places = Places::of(&records);
            for i in 1000..1200 {
                let (p, distance) = (point(i), 0.5 * number(20_000 + i));
                let mut found: Vec<u32> = places.within(distance, p).collect();
                found.sort_unstable();
                let near = |&index: &u32| records[index as usize].site.position.distance(p) <= distance;
                let expected: Vec<u32> = (0..count as u32).filter(near).collect();
                assert_eq!(found, expected, "within {distance} of point {i}, of {count}");
                all += found.len();
            }
        }
        assert!(all > 1000, "the test met {all} cases only");
    }

    #[test]
    fn cells_that_follow_each_other_are_close() {
        let records = records(2000);
        let cells = Cells::around(&records);
        let scattered: Vec<Vec3> = records.iter().map(|planned| planned.site.position).collect();
        let mut order = scattered.clone();
        order.sort_by_cached_key(|&position| cells.number(position));
        assert!(order.iter().all(|&position| cells.number(position) < Cells::COUNT));
        let way = |places: &[Vec3]| places.windows(2).map(|pair| pair[0].distance(pair[1])).sum::<f32>();
        assert!(way(&order) * 4.0 < way(&scattered));
    }
}
