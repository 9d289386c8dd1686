//! The irradiance cache: plan, fill, read.
//!
//! Indirect diffuse light is gathered at few places, the *records*, and interpolated (Ward, Rubinstein and
//! Clear 1988). In the classic cache, the number of records depends on the order of pixels and threads. This
//! cache has three phases instead:
//!
//! 1. **Plan** (`plan`): the insertion rule runs over the first diffuse hits of all pixels, also behind
//!    mirrors and glass, in a fixed coarse-to-fine order. A record's radius comes from 48 stratified rays:
//!    from the distances to their hits, and from how much light they bring.
//! 2. **Fill** (`gather`): the hemisphere above every planned record is gathered, on any thread or machine
//!    and in any order. The plan's rays are strata of the gather. They also tell where bright light comes
//!    from, and neighbours send more rays there (`guide`). Records that agree are then averaged (`smooth`).
//! 3. **Read** (`read`): image samples only read. A point that no record covers gathers for itself, and is
//!    counted.
//!
//! Light that comes by way of small bright places has edges, which records are too far apart to show. Where there
//! is much of it, the plan also chooses *secondary lights*: gathers leave them out, and points sample them
//! (`secondary`).
//!
//! Further diffuse bounces have their own levels. The second is planned from the hits of the first, and
//! filled before it. So with all further ones. Only rays of gathers read them, and many of these are averaged, so
//! they may be coarse.
//!
//! | file | subject |
//! | --- | --- |
//! | `site`, `record` | points where irradiance is needed; records, and the error of using one at a site |
//! | `index` | finds the records that may cover a site, by position and orientation |
//! | `spheres`, `octree`, `loose` | queries for spheres that contain a point or touch another sphere |
//! | `coverage` | the records of a level while it is planned |
//! | `places` | finds records near a point; space-filling order |
//! | `hemisphere` | strata of a gather; irradiance and its gradients |
//! | `secondary`, `survey` | small bright places that points sample themselves; how they are found |
//! | `guide` | more rays for strata where the light is concentrated |
//! | `plan`, `gather`, `smooth`, `read` | the phases |
//! | `sample` | gathers a few records to measure their cost |
//! | `partial` | fills only the records that some pixels read |
//! | `share` | records of one frame that are valid in another |
//! | `file`, `error` | the file format and its errors |

mod coverage;
mod error;
mod file;
mod gather;
mod guide;
mod hemisphere;
mod index;
mod loose;
mod octree;
mod partial;
mod places;
mod plan;
mod read;
mod record;
mod sample;
mod secondary;
mod share;
mod site;
mod smooth;
mod spheres;
mod survey;

pub use error::CacheError;
pub use hemisphere::{Irradiance, Mean, PLAN_RAYS, Sample, Strata};
pub use record::{Planned, Record, RecordCost};
pub use secondary::{SecondaryLights, Seen};
pub use share::Shared;
pub use site::{Keyed, Site};

use crate::bounds::Bounds;
use crate::cost::{Cost, Rays, add_rays};
use crate::origin::Origin;
use crate::tracer::Tracer;
use forelight_bvh::Hit;
use forelight_scene::Geometry;
use guide::Guide;
use index::Index;
use places::Places;
use record::{Smoothed, Value};
use std::sync::OnceLock;

/// Records of the first level are read up to this many times farther than they were planned to cover. Several records
/// then blend at every point, and samples between the planned sites are covered too.
const READ_RELAXED: f32 = 1.6;

/// The records of one bounce.
#[derive(Debug, Default, Clone)]
pub struct Level {
    /// Strata of the gathers.
    strata: Strata,
    planned: Vec<Planned>,
    records: Vec<OnceLock<Record>>,
    /// Smoothed value of each planned record, if known from a file or from before more were planned.
    known: Vec<Option<Value>>,
    /// The values that are read, available once all records are filled.
    smoothed: OnceLock<Smoothed>,
    /// Index for reading.
    index: Index,
    /// The first `explored` records have already been followed to the next level.
    explored: usize,
    /// Allowed error; see [`Planned::error`].
    accuracy: f32,
    /// Whether it is the first level. The gathers that read deeper levels average their errors, so that only here
    /// bright spots get more rays, and values are interpolated.
    is_first: bool,
    /// Mean radiance of the plan's rays at some points of the first plan's image, mean over the channels.
    brightness: f32,
    /// Chosen with the first plan.
    secondary: SecondaryLights,
    /// Places of the planned records, made when first needed: a full cache that is only read needs none.
    places: OnceLock<Places>,
    /// Made when first needed, for the same reason.
    guide: OnceLock<Guide>,
    /// Bounds of the radii, metres.
    smallest: f32,
    largest: f32,
}

/// A frame's irradiance cache.
#[derive(Debug, Default, Clone)]
pub struct Cache {
    /// Hash of everything that its records depend on; see [`crate::fingerprint`].
    fingerprint: [u8; 32],
    /// The frame whose world the records are in, and the settings of the first plan.
    origin: Origin,
    /// Fingerprints of the images that it has been planned for.
    images: Vec<[u8; 32]>,
    /// Bounding box of the scene's vertices, metres. The octrees cover it.
    world: Bounds,
    levels: Vec<Level>,
    /// Cost of planning.
    plan: Cost,
    plan_rays: Rays,
    /// CPU time of reading the cache from a file, nanoseconds.
    reading: u64,
    /// What it holds of a shared cache.
    shared: Shared,
    /// Set if only the first level was filled, for some pixels. Rays then follow deeper levels.
    partial: OnceLock<()>,
}

/// Number of records and cost of a cache.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CacheTotals {
    /// Number of records of each level.
    pub records: Vec<u64>,
    /// Cost of planning.
    pub plan: Cost,
    /// Rays of planning, by category.
    pub plan_rays: Rays,
    /// Cost of the filled records, including smoothing.
    pub fill: Cost,
    /// Rays of gathering, by category.
    pub fill_rays: Rays,
    /// Number of filled records.
    pub filled: u64,
    /// Number of filled records that are not finite, and therefore never used.
    pub rejected: u64,
    /// Number of secondary lights.
    pub secondary_lights: u64,
}

impl Level {
    /// Indexes the planned records. `world` is the bounding box of the scene.
    fn prepare(&mut self, world: Bounds) {
        let mut index = Index::new(world, self.smallest, self.allowed());
        self.planned.iter().zip(0..).for_each(|(planned, number)| index.insert(number, planned));
        (self.index, self.places, self.guide) = (index, OnceLock::new(), OnceLock::new());
    }

    /// Lets the rays of new records bring nothing from secondary lights: so they do not guide gathers there.
    fn leave_out_secondary_lights(&mut self, geometry: &Geometry) {
        if self.secondary.is_empty() {
            return;
        }
        for planned in &mut self.planned[self.explored..] {
            let Planned { site, hits, lit, .. } = planned;
            for (hit, lit) in hits.iter().zip(lit.iter_mut()) {
                let is_met = |hit: &Hit| self.secondary.met(hit, site.position, geometry).is_some();
                if hit.as_ref().is_some_and(is_met) {
                    *lit = 0.0;
                }
            }
        }
    }

    /// The error below which records are read; see [`Planned::error`].
    fn allowed(&self) -> f32 {
        if self.is_first { self.accuracy * READ_RELAXED } else { self.accuracy }
    }

    fn places(&self) -> &Places {
        self.places.get_or_init(|| Places::of(&self.planned))
    }

    fn guide(&self) -> &Guide {
        self.guide.get_or_init(|| match self.is_first {
            true => Guide::new(&self.planned, &self.strata, self.brightness),
            false => Guide::default(),
        })
    }

    /// Makes what gathers need, so that no single record is charged for it.
    fn make_ready_to_gather(&self) {
        self.places();
        self.guide();
    }

    fn is_full(&self) -> bool {
        self.records.iter().all(|record| record.get().is_some())
    }
}

impl Cache {
    /// Number of records of each level.
    pub fn records(&self) -> Vec<u64> {
        self.levels.iter().map(|level| level.planned.len() as u64).collect()
    }

    /// Returns `true` if all records of a level are filled.
    pub fn is_full(&self, level: usize) -> bool {
        self.levels.get(level).is_none_or(Level::is_full)
    }

    /// Indices of a level's records that are not filled, ascending.
    pub fn unfilled(&self, level: usize) -> Vec<usize> {
        let records = &self.levels[level].records;
        (0..records.len()).filter(|&index| records[index].get().is_none()).collect()
    }

    /// Returns `true` if all records of all levels are filled.
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

    /// Small bright places that are left out of the records of the first level: points sample them. `None` before
    /// the cache is planned.
    pub fn secondary_lights(&self) -> Option<&SecondaryLights> {
        self.levels.first().map(|level| &level.secondary)
    }

    /// Number of the frame that the cache was first planned for.
    pub fn frame(&self) -> u32 {
        self.origin.frame()
    }

    /// A copy without CPU times. Two caches with the same plan are then equal byte by byte.
    pub fn without_times(&self) -> Self {
        let mut cache = self.clone();
        cache.plan.cpu_nanos = 0;
        cache.reading = 0;
        cache.gathered_mut().for_each(|record| record.cost.cpu_nanos = 0);
        cache
    }

    /// The records of a shared cache that a frame starts with, with all costs set to zero: the frame is not
    /// charged for them.
    pub fn as_given(mut self, shared: Shared) -> Self {
        self.shared = shared;
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

    /// Records of a shared cache that a frame took over into this one, and those that were not valid in it.
    pub fn shared(&self) -> &Shared {
        &self.shared
    }

    /// Whether planning has nothing to add for the tracer's image.
    pub fn is_planned_for(&self, tracer: &Tracer) -> bool {
        self.images.contains(&tracer.fingerprint())
    }

    /// CPU time of reading the cache from a file, nanoseconds. 0 if it did not come from a file.
    pub fn reading_nanos(&self) -> u64 {
        self.reading
    }

    /// Number of records and cost.
    pub fn totals(&self) -> CacheTotals {
        let mut totals = CacheTotals {
            records: self.records(),
            plan: self.plan,
            plan_rays: self.plan_rays,
            secondary_lights: self.secondary_lights().map_or(0, |lights| lights.all().len() as u64),
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
