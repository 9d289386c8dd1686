//! The records of a level while it is planned.

use super::index::Index;
use super::loose::LooseOctree;
use super::octree::Cube;
use super::spheres::Sphere;
use super::{Level, Planned, Site};
use crate::bounds::Bounds;

/// A level that grows. It finds the records that cover a site, and the records near a new one.
pub struct Coverage<'a> {
    level: &'a mut Level,
    covered: Index,
    /// How far each record is read.
    read: LooseOctree,
}

impl<'a> Coverage<'a> {
    pub fn of(level: &'a mut Level, world: Bounds) -> Self {
        let covered = Index::new(world, level.smallest, level.accuracy);
        let read = LooseOctree::over(Cube::over(world, level.reach(level.smallest)));
        let records = level.planned.len();
        let mut coverage = Self { level, covered, read };
        (0..records).for_each(|number| coverage.enter(number));
        coverage
    }

    pub fn level(&self) -> &Level {
        self.level
    }

    /// Returns `true` if a record may be used at a site within the allowed error.
    pub fn covers(&self, place: &Site) -> bool {
        let Level { planned, accuracy, .. } = &*self.level;
        self.covered
            .around(place, |_| ())
            .any(|number| planned[number as usize].error(place, *accuracy).is_some())
    }

    /// Adds a record, with neighbour clamping (Křivánek et al. 2006): radii of neighbours differ by at most
    /// their distance. So a record whose rays missed a small nearby object is corrected.
    pub fn insert(&mut self, mut planned: Planned) {
        let level = &mut *self.level;
        let position = planned.site.position;
        let mut neighbours = Vec::new();
        self.read.touching(position, planned.radius * level.accuracy, |neighbour| neighbours.push(neighbour));
        for &neighbour in &neighbours {
            let other = &level.planned[neighbour as usize];
            let distance = other.site.position.distance(position);
            planned.radius = planned.radius.min(other.radius + distance);
        }
        planned.radius = planned.radius.max(level.smallest);
        for neighbour in neighbours {
            let other = &mut level.planned[neighbour as usize];
            let distance = other.site.position.distance(position);
            other.radius = other.radius.min(planned.radius + distance);
        }
        level.planned.push(planned);
        self.enter(self.level.planned.len() - 1);
    }

    /// Adds a record to both indices, with its current radius. Later neighbours may reduce that radius.
    fn enter(&mut self, number: usize) {
        let (planned, index) = (&self.level.planned[number], number as u32);
        self.covered.insert(index, planned);
        let radius = self.level.reach(planned.radius);
        self.read.insert(Sphere { index, center: planned.site.position, radius, sets: 0 });
    }
}

impl Level {
    /// Largest distance at which a record of this radius is read, metres.
    fn reach(&self, radius: f32) -> f32 {
        radius * self.allowed()
    }
}
