//! The cost of tracing: rays by category, work and CPU time. Work is a weighted count of operations, the same
//! in every run and close to proportional to time. [`Counters`] counts one pixel.

use forelight_bvh::Traversal;
pub use forelight_threads::{clocked, process_cpu_nanos};
use std::ops::{Add, AddAssign};
use std::sync::atomic::{AtomicU64, Ordering};

/// Names of the seven ray categories, in the order of [`Rays`] (Gillibrand et al. 2006, section 2).
pub const RAY_NAMES: [&str; 7] =
    ["primary", "shadow", "transparent", "reflected", "refracted", "ambient", "specular"];

/// Index of a category in [`Rays`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Category {
    #[default]
    Primary,
    Shadow,
    Transparent,
    Reflected,
    Refracted,
    Ambient,
    Specular,
}

/// Number of rays by category, in the order of [`RAY_NAMES`].
pub type Rays = [u64; 7];

/// Work by the category of the ray that caused it, in the order of [`RAY_NAMES`]: its traversal and
/// everything at its end. All work that follows from a gathered ray, and reading the irradiance cache, is
/// ambient.
pub type WorkByRay = [u64; 7];

/// Adds rays to a sum, category by category.
pub fn add_rays<R: Copy + Into<u64>>(sum: &mut Rays, rays: &[R; 7]) {
    sum.iter_mut().zip(rays).for_each(|(sum, &rays)| *sum += rays.into());
}

/// A cost, as work and as CPU time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Cost {
    /// Deterministic, weighted count of operations; see [`work`].
    pub work: u64,
    /// CPU time of the thread that did the work, nanoseconds.
    pub cpu_nanos: u64,
}

impl Add for Cost {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { work: self.work + other.work, cpu_nanos: self.cpu_nanos + other.cpu_nanos }
    }
}

impl AddAssign for Cost {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

/// Operation counts of one pixel.
#[derive(Debug, Clone, Default)]
pub struct Counters {
    pub rays: [u32; 7],
    pub traversal: Traversal,
    pub shadings: u64,
    pub texels: u64,
    /// Number of points at which the cache was interpolated.
    pub reads: u64,
    /// Number of points at which one record was read.
    pub single_reads: u64,
    /// Number of cache records that were considered.
    pub records: u64,
    /// Number of points at which the cache was read and no record covered the point.
    pub uncovered: u32,
    /// Work that belongs to the first camera samples; see [`crate::Pixel::extra_work`].
    pub extra_work: u64,
    account: Account,
}

/// Attribution of work to ray categories.
#[derive(Debug, Clone, Default)]
struct Account {
    by_ray: WorkByRay,
    /// Category of the ray that causes the current work.
    cause: Category,
    /// Work that is already attributed.
    so_far: u64,
}

impl Counters {
    pub fn ray(&mut self, category: Category) {
        self.rays[category as usize] += 1;
    }

    /// Attributes work to rays of this category from now on; work of gathered rays stays ambient. Returns the
    /// previous category for [`Self::back_to`].
    pub fn caused_by(&mut self, category: Category) -> Category {
        let before = self.account.cause;
        if before != Category::Ambient {
            self.back_to(category);
        }
        before
    }

    /// Attributes work to rays of this category from now on.
    pub fn back_to(&mut self, category: Category) {
        if category != self.account.cause {
            let (work, account) = (self.work(), &mut self.account);
            account.by_ray[account.cause as usize] += work - account.so_far;
            (account.so_far, account.cause) = (work, category);
        }
    }

    pub fn work_by_ray(&self) -> WorkByRay {
        let mut by_ray = self.account.by_ray;
        by_ray[self.account.cause as usize] += self.work() - self.account.so_far;
        by_ray
    }

    pub fn work(&self) -> u64 {
        self.work_by_class().iter().sum()
    }

    /// The work by class.
    pub fn work_by_class(&self) -> WorkByClass {
        let rays = self.rays.iter().map(|&r| u64::from(r)).sum();
        let Traversal { nodes, triangles, .. } = self.traversal;
        [
            work(rays, 0, 0, 0, 0),
            work(0, nodes, triangles, 0, 0),
            work(0, 0, 0, self.shadings, 0),
            work(0, 0, 0, 0, self.texels),
            READ_WORK * self.reads + SINGLE_READ_WORK * self.single_reads + RECORD_WORK * self.records,
        ]
    }
}

/// Names of the classes of work, in the order of [`WorkByClass`]: the base cost of each ray, tree traversal,
/// shading, texture lookups, and reading records of the irradiance cache.
pub const WORK_CLASSES: [&str; 5] = ["rays", "traversal", "shading", "texture", "records"];

/// Work by class, in the order of [`WORK_CLASSES`].
pub type WorkByClass = [u64; 5];

/// Work by class, summed over threads. Integer sums are the same in any order.
#[derive(Debug, Default)]
pub struct Tally([AtomicU64; 5]);

impl Tally {
    pub fn add(&self, work: WorkByClass) {
        for (sum, work) in self.0.iter().zip(work).filter(|(_, work)| *work > 0) {
            sum.fetch_add(work, Ordering::Relaxed);
        }
    }

    pub fn sum(&self) -> WorkByClass {
        std::array::from_fn(|class| self.0[class].load(Ordering::Relaxed))
    }
}

/// Work of reading the cache at a point: finding the records, and interpolating between four or five.
const READ_WORK: u64 = 300;

/// Work of reading one record at a point.
const SINGLE_READ_WORK: u64 = 100;

/// Work of considering one cache record.
const RECORD_WORK: u64 = 4;

/// Work of allotting a record's rays by those of 40 neighbours. Constant, so that a record's cost is known at
/// once.
pub const GUIDING_WORK: u64 = 12_000;

/// Work of averaging a record with about 280 neighbours. Constant for the same reason.
pub const SMOOTHING_WORK: u64 = 3400;

/// Work: operations weighted by their time on a present-day core, in units of about a nanosecond. The weights
/// come from a regression of time on counts over the test scenes.
pub fn work(rays: u64, nodes: u64, triangles: u64, shadings: u64, texels: u64) -> u64 {
    60 * rays + 14 * nodes + 5 * triangles + 120 * shadings + 40 * texels
}

/// Work of building a tree. Sorting, reinsertion and collapse are close to linear in the number of triangles.
pub fn build_work(triangles: usize, nodes: usize) -> u64 {
    2000 * triangles as u64 + 500 * nodes as u64
}

/// Work of reading a kept tree and checking it.
pub fn load_work(triangles: usize, nodes: usize) -> u64 {
    100 * triangles as u64 + 100 * nodes as u64
}

/// Runs `trace`, and converts the wall-clock time of each traced pixel to CPU time. `trace` returns each
/// pixel's time before, and a reference to its time now. Wall-clock time includes other processes; the CPU
/// clock is too slow to read per pixel. So each pixel gets its share of the batch's CPU time.
pub(crate) fn share_cpu_time<'a>(trace: impl FnOnce() -> Vec<(u64, &'a mut u64)>) {
    let (pixels, cpu) = clocked(trace);
    let wall: u64 = pixels.iter().map(|(before, now)| **now - before).sum();
    if wall > 0 {
        let share = cpu as f64 / wall as f64;
        for (before, now) in pixels {
            *now = before + ((*now - before) as f64 * share).round() as u64;
        }
    }
}
