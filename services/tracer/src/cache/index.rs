//! Finds the records that may cover a site, by position and by orientation: one set of records per axis
//! direction. In a cluttered room, most nearby records face elsewhere.

use super::octree::{Cube, Octree};
use super::record::Planned;
use super::site::Site;
use super::spheres::{SETS, Sphere};
use crate::bounds::Bounds;
use glam::Vec3;

/// The axis directions: +x, −x, +y, −y, +z, −z.
const DIRECTIONS: usize = SETS;

/// Tolerance, much larger than the rounding errors of a cosine.
const ROUNDING: f32 = 1e-4;

/// Planned records, found by the sites that they may cover.
#[derive(Debug, Default, Clone)]
pub struct Index {
    octree: Octree,
    /// The allowed error. A record covers sites up to this fraction of its radius away.
    allowed: f32,
    /// Smallest cosine between the normals of a record and a site that it may cover.
    least_cos: f32,
}

impl Index {
    /// An empty index for the box `world`. `smallest`: lower bound of radii in metres; `allowed`: allowed
    /// error.
    pub fn new(world: Bounds, smallest: f32, allowed: f32) -> Self {
        // Rotation alone adds √(1 − cos) to the error (`Planned::error`), so no record covers a site facing
        // away.
        let least_cos = (1.0 - allowed * allowed).max(0.0) - ROUNDING;
        Self { octree: Octree::over(Cube::over(world, smallest * allowed)), allowed, least_cos }
    }

    /// Adds a record under its number.
    pub fn insert(&mut self, number: u32, planned: &Planned) {
        let Site { position, normal, .. } = planned.site;
        let may_face = |direction: &usize| greatest_cos(normal, *direction) >= self.least_cos;
        let sets = (0..DIRECTIONS).filter(may_face).fold(0, |sets, direction| sets | 1 << direction);
        let radius = planned.radius * self.allowed;
        self.octree.insert(Sphere { index: number, center: position, radius, sets });
    }

    /// Numbers of the records that may cover a site, in an order that depends only on the insertions.
    /// `looked_at` is called with the number of records considered.
    pub fn around(&self, place: &Site, mut looked_at: impl FnMut(u64)) -> impl Iterator<Item = u32> {
        let (position, direction) = (place.position, direction_of(place.normal));
        self.octree.near(position).flat_map(move |block| {
            looked_at(block.count(direction));
            block.holding(direction, position)
        })
    }

    /// Numbers of the records that may cover a site at this point, whatever its orientation.
    pub fn at(&self, point: Vec3) -> impl Iterator<Item = u32> {
        self.octree.near(point).flat_map(move |block| block.touching(point, 0.0))
    }
}

/// The axis direction that a normal points along most.
pub fn direction_of(normal: Vec3) -> usize {
    let axis = normal.abs().max_position();
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// Largest cosine between a unit normal and any normal mainly along `direction` (a pyramid through a cube
/// face).
fn greatest_cos(normal: Vec3, direction: usize) -> f32 {
    let axis = direction / 2;
    let along = if direction.is_multiple_of(2) { normal[axis] } else { -normal[axis] };
    let (u, v) = (normal[(axis + 1) % 3].abs(), normal[(axis + 2) % 3].abs());
    let (more, less) = (u.max(v), u.min(v));
    let half = 0.5 * (along + more);
    match () {
        () if along >= more => 1.0,
        // The cosine with the nearest side of the pyramid, or with its edge beside that side.
        () if half >= less => (2.0 * half * half + less * less).sqrt(),
        () => (along + more + less) / 3f32.sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::octree::tests::{number, point};

    /// The i-th of unit vectors spread over the sphere. Every eighth is along an axis, where octants meet.
    fn normal(i: u64) -> Vec3 {
        match i % 8 {
            0 => [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z][(i / 8 % 6) as usize],
            1 => Vec3::new(1.0, if i % 16 == 1 { 1.0 } else { -1.0 }, 0.0).normalize(),
            _ => (point(i + 70_000) - 0.5).normalize(),
        }
    }

    fn site(i: u64) -> Site {
        Site::bare(0.3 * point(i), normal(i))
    }

    fn planned(i: u64) -> Planned {
        Planned::in_the_open(site(i), 0.05 * 16f32.powf(number(i + 90_000)))
    }

    #[test]
    fn every_record_that_serves_a_place_is_found_whatever_error_is_allowed() {
        // With the largest allowed error, every record that does not face away may be used.
        for (allowed, most) in [(0.12, 0.4), (0.3, 0.5), (0.7, 0.7), (1.6, 0.95)] {
            let records: Vec<Planned> = (0..2000).map(planned).collect();
            let mut index = Index::new(Bounds { low: Vec3::ZERO, high: Vec3::ONE }, 0.05, allowed);
            records.iter().zip(0..).for_each(|(record, number)| index.insert(number, record));
            let (mut served, mut around_place, mut all) = (0, 0, 0);
            for i in 3000..4000 {
                let place = site(i);
                let around: Vec<u32> = index.around(&place, |_| ()).collect();
                let everywhere: Vec<u32> = index.at(place.position).collect();
                all += everywhere.len();
                around_place += around.len();
                for (record, number) in records.iter().zip(0..) {
                    if record.error(&place, allowed).is_some() {
                        served += 1;
                        assert!(around.contains(&number), "record {number} misses place {i}");
                        assert!(everywhere.contains(&number), "record {number} misses point {i}");
                    }
                }
            }
            assert!(served > 30, "the test met {served} cases only with {allowed}");
            let share = around_place as f64 / all as f64;
            assert!(share < most, "{share:.2} of what is near is looked at with {allowed}");
        }
    }

    #[test]
    fn a_pyramid_is_as_far_from_a_normal_as_the_nearest_of_its_directions() {
        let many: Vec<Vec3> = (0..100_000).map(|i| (point(i) - 0.5).normalize()).collect();
        let mut of_direction: [Vec<Vec3>; DIRECTIONS] = Default::default();
        many.iter().for_each(|&n| of_direction[direction_of(n)].push(n));
        for i in 0..64 {
            for (direction, inside) in of_direction.iter().enumerate() {
                let n = normal(i);
                let nearest = inside.iter().map(|other| n.dot(*other)).fold(-1.0, f32::max);
                let greatest = greatest_cos(n, direction);
                assert!(
                    greatest >= nearest - 1e-6 && greatest < nearest + 0.02,
                    "{n} {direction}: {greatest} {nearest}"
                );
            }
        }
    }
}
