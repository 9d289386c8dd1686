//! The irradiance cache: planned, filled, read.
//!
//! Indirect diffuse light changes slowly over a surface, so it is gathered at few places, the *records*, and interpolated between
//! them (Ward, Rubinstein, Clear 1988). Where the classic cache makes a record when it happens to need one, so that number
//! and cost depend on the order of pixels and threads, this one has three phases:
//!
//! 1. **Plan** (`plan`): the rule by which records are placed runs over the first diffuse hits of all pixels (also by way of mirrors
//!    and glass) in a fixed, coarse-to-fine order. A record's radius comes from 48 stratified rays that look for distances only.
//!    After it the number of records is known, not guessed.
//! 2. **Fill** (`gather`): the hemisphere above every planned record is gathered, on any thread or machine, in any order;
//!    the plan's rays are strata of the gather and are not traced again.
//!    Records that agree are then averaged (`smooth`): their gathers share what they found.
//! 3. **Read** (`read`): image samples only read. A point that no record covers gathers for itself, as without a cache, and is
//!    counted.
//!
//! Further diffuse bounces have levels of their own: the second level is planned from the hits of the first level's rays, and
//! filled before it.
//!
//! | file | subject |
//! | --- | --- |
//! | `site` | where irradiance is wanted, and when one place serves for another |
//! | `index` | which records may serve a place, by where they are and where they face |
//! | `spheres`, `octree`, `loose` | spheres, by the points that they hold and by the spheres that they touch |
//! | `coverage` | records while others are planned |
//! | `places` | which records are near each other |
//! | `hemisphere` | strata of a gather; irradiance and its gradients from them |
//! | `plan`, `gather`, `smooth`, `read` | the phases |
//! | `sample` | what a record takes, from a few of them |
//! | `partial` | filling what some pixels read |
//! | `share` | records of one frame that hold in another |
//! | `file` | the artefact |

mod coverage;
mod file;
mod gather;
mod hemisphere;
mod index;
mod loose;
mod octree;
mod partial;
mod places;
mod plan;
mod read;
mod sample;
mod share;
mod site;
mod smooth;
mod spheres;

pub use file::CacheError;
pub use hemisphere::{Irradiance, PLAN_RAYS, Sample, Strata};
pub use plan::Keyed;
pub use sample::RecordCost;
pub use share::Shared;
pub use site::Site;

use crate::bounds::Bounds;
use crate::cost::{Cost, Rays, add_rays};
use crate::origin::Origin;
use crate::tracer::Tracer;
use forelight_bvh::Hit;
use glam::Vec3;
use index::Index;
use smooth::{Smoothed, Value};
use std::sync::OnceLock;

/// Records are read that much farther than they are planned to cover: several of them blend everywhere, and the samples between
/// the planned places find some.
const READ_RELAXED: f32 = 1.6;

/// A planned record.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Key of the random numbers of its gather.
    pub key: u64,
    /// Where it is.
    pub site: Site,
    /// How far it is valid, before the allowed error scales it, metres.
    pub radius: f32,
    /// Distance to what blocks the way along the surface, by sector of azimuth, metres.
    pub corral: [f32; hemisphere::SECTORS],
    /// What the plan's rays met; apart from the rest, which reading looks at millions of times.
    pub hits: Box<[Option<Hit>; PLAN_RAYS]>,
}

/// What was gathered at a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Irradiance, W/m² per channel, as it arrives under the surface's coat.
    pub irradiance: Vec3,
    /// Change of each channel's irradiance with the normal's rotation, per radian.
    pub rotation: [Vec3; 3],
    /// Change of each channel's irradiance along the surface, per metre.
    pub translation: [Vec3; 3],
    /// Radius within which the gradients can be trusted, metres: at most the planned one.
    pub trusted: f32,
    /// Standard error of the irradiance, mean of the channels, W/m²: what its rays leave open.
    pub noise: f32,
    /// Whether a number of it is not finite: such a record is never used.
    pub rejected: bool,
    /// What gathering it took.
    pub cost: Cost,
    /// Rays of it, by category.
    pub rays: [u32; 7],
}

/// The records of one bounce.
#[derive(Debug, Default, Clone)]
pub struct Level {
    /// Of the gathers.
    strata: Strata,
    planned: Vec<Planned>,
    records: Vec<OnceLock<Record>>,
    /// What each planned record says to those that read it, if that was found out before: in a file, or before others were planned.
    known: Vec<Option<Value>>,
    /// What is read, once all records are filled.
    smoothed: OnceLock<Smoothed>,
    /// Of what is read.
    index: Index,
    /// So many of the records, the first ones, have been followed to the next level.
    explored: usize,
    /// Allowed error, see [`site::error`].
    accuracy: f32,
    /// Bounds of the radii, metres.
    smallest: f32,
    largest: f32,
}

/// A frame's cache.
#[derive(Debug, Default, Clone)]
pub struct Cache {
    /// What its records depend on, see [`crate::fingerprint`].
    fingerprint: [u8; 32],
    /// The frame whose world the records are in, and the settings that they were planned for first.
    origin: Origin,
    /// The images that it has been planned for, by their fingerprints.
    images: Vec<[u8; 32]>,
    /// Box around the world's vertices, metres: what the octrees are over.
    world: Bounds,
    levels: Vec<Level>,
    /// What planning took.
    plan: Cost,
    plan_rays: Rays,
    /// What reading the file took that it came from, nanoseconds.
    reading: u64,
    /// Set when the first level alone was filled, for some pixels: deeper points are then followed, not interpolated.
    partial: OnceLock<()>,
}

/// What a cache holds and took, in numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CacheTotals {
    /// Records by level.
    pub records: Vec<u64>,
    /// What planning took.
    pub plan: Cost,
    /// Rays of planning.
    pub plan_rays: Rays,
    /// What gathering took, of the records that are filled, and smoothing them.
    pub fill: Cost,
    /// Rays of gathering.
    pub fill_rays: Rays,
    /// Records that are filled.
    pub filled: u64,
    /// Records among them that are not finite, and never used.
    pub rejected: u64,
}

impl Level {
    /// The index of its records, in a world.
    fn indexed(&self, world: Bounds) -> Index {
        let mut index = Index::new(world, self.smallest, self.accuracy * READ_RELAXED);
        self.planned.iter().zip(0..).for_each(|(planned, number)| index.insert(number, planned));
        index
    }

    fn is_full(&self) -> bool {
        self.records.iter().all(|record| record.get().is_some())
    }
}

impl Cache {
    /// Number of records by level.
    pub fn records(&self) -> Vec<u64> {
        self.levels.iter().map(|level| level.planned.len() as u64).collect()
    }

    /// Whether all records of a level are filled.
    pub fn is_full(&self, level: usize) -> bool {
        self.levels.get(level).is_none_or(Level::is_full)
    }

    /// Whether all records of all levels are filled.
    pub fn is_complete(&self) -> bool {
        self.levels.iter().all(Level::is_full)
    }

    /// The planned records of a level.
    pub fn planned(&self, level: usize) -> &[Planned] {
        &self.levels[level].planned
    }

    /// A record, if it is filled.
    pub fn record(&self, level: usize, index: usize) -> Option<&Record> {
        self.levels[level].records[index].get()
    }

    /// Number of the frame whose world the records are in: it was planned for this one first.
    pub fn frame(&self) -> u32 {
        self.origin.frame()
    }

    /// Whether its records hold in the frame of a tracer as they are: same geometry, same light, same settings of light.
    pub fn suits(&self, tracer: &Tracer) -> bool {
        self.fingerprint == tracer.cache_fingerprint()
    }

    /// The same without the times that its making took: two caches of one plan are then equal byte by byte.
    pub fn without_times(&self) -> Self {
        let mut cache = self.clone();
        cache.plan.cpu_nanos = 0;
        cache.reading = 0;
        cache.gathered_mut().for_each(|record| record.cost.cpu_nanos = 0);
        cache
    }

    /// The same as if it had cost nothing: for a frame that is given it, and is not to be charged for it.
    pub fn as_given(mut self) -> Self {
        self.plan = Cost::default();
        self.plan_rays = Rays::default();
        self.gathered_mut().for_each(|record| (record.cost, record.rays) = (Cost::default(), [0; 7]));
        self.levels
            .iter_mut()
            .filter_map(|level| level.smoothed.get_mut())
            .for_each(|smoothed| smoothed.cpu_nanos = 0);
        self
    }

    fn gathered_mut(&mut self) -> impl Iterator<Item = &mut Record> {
        self.levels.iter_mut().flat_map(|level| &mut level.records).filter_map(OnceLock::get_mut)
    }

    /// CPU time of reading the file that it came from, nanoseconds; 0 if it came from none.
    pub fn reading_nanos(&self) -> u64 {
        self.reading
    }

    /// What it holds and took.
    pub fn totals(&self) -> CacheTotals {
        let mut totals = CacheTotals {
            records: self.records(),
            plan: self.plan,
            plan_rays: self.plan_rays,
            ..CacheTotals::default()
        };
        for smoothed in self.levels.iter().filter_map(|level| level.smoothed.get()) {
            totals.fill.cpu_nanos += smoothed.cpu_nanos;
        }
        let records = self.levels.iter().flat_map(|level| &level.records);
        for record in records.filter_map(OnceLock::get) {
            totals.filled += 1;
            totals.rejected += u64::from(record.rejected);
            totals.fill += record.cost;
            add_rays(&mut totals.fill_rays, &record.rays);
        }
        totals
    }
}
