//! What tracing took: rays by category, deterministic work, CPU time.

use forelight_bvh::Traversal;
use std::ops::{Add, AddAssign};
use std::sync::atomic::{AtomicU64, Ordering};

/// Names of the seven ray categories, in the order of [`Rays`] (paper, section 2).
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

/// Rays by category, in the order of [`RAY_NAMES`].
pub type Rays = [u64; 7];

/// Work by the ray that brought it about, in the order of [`RAY_NAMES`]: going along the ray, and what is done where it ends. Everything
/// that comes of a gathered ray is ambient, and so is reading the irradiance cache: work that would not be there without indirect
/// light.
pub type WorkByRay = [u64; 7];

/// Adds rays to a sum, category by category.
pub fn add_rays<R: Copy + Into<u64>>(sum: &mut Rays, rays: &[R; 7]) {
    sum.iter_mut().zip(rays).for_each(|(sum, &rays)| *sum += rays.into());
}

/// A cost in both currencies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Cost {
    /// Deterministic count of operations, see [`work`].
    pub work: u64,
    /// CPU time of the thread that did it, nanoseconds.
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

/// Operations of one pixel.
#[derive(Debug, Clone, Default)]
pub struct Counters {
    pub rays: [u32; 7],
    pub traversal: Traversal,
    pub shadings: u64,
    pub texels: u64,
    /// Points at which a cache was read.
    pub reads: u64,
    /// Cache records that were looked at.
    pub records: u64,
    /// Points at which a cache was read and had no record.
    pub uncovered: u32,
    /// Work that goes with the first camera samples, see [`crate::Pixel::extra_work`].
    pub extra_work: u64,
    account: Account,
}

/// What work is put down to.
#[derive(Debug, Clone, Default)]
struct Account {
    by_ray: WorkByRay,
    /// The ray that work is for now.
    cause: Category,
    /// Work that is put down already.
    so_far: u64,
}

impl Counters {
    pub fn ray(&mut self, category: Category) {
        self.rays[category as usize] += 1;
    }

    /// From now on work is for a ray of this category, or still for gathered rays. Gives what it was for; hand that to [`Self::back_to`].
    pub fn caused_by(&mut self, category: Category) -> Category {
        let before = self.account.cause;
        if before != Category::Ambient {
            self.back_to(category);
        }
        before
    }

    /// From now on work is for a ray of this category.
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

    /// The same by what is done.
    pub fn work_by_class(&self) -> WorkByClass {
        let rays = self.rays.iter().map(|&r| u64::from(r)).sum();
        let Traversal { nodes, triangles, .. } = self.traversal;
        [
            work(rays, 0, 0, 0, 0),
            work(0, nodes, triangles, 0, 0),
            work(0, 0, 0, self.shadings, 0),
            work(0, 0, 0, 0, self.texels),
            READ_WORK * self.reads + RECORD_WORK * self.records,
        ]
    }
}

/// Names of the classes of work, in the order of [`WorkByClass`]: what comes with every ray, going through the tree, what surfaces do
/// with light, looking up images, and the irradiance cache's records.
pub const WORK_CLASSES: [&str; 5] = ["rays", "traversal", "shading", "texture", "records"];

/// Work by class, in the order of [`WORK_CLASSES`].
pub type WorkByClass = [u64; 5];

/// Work by class that many threads add up. A sum of whole numbers is the same in any order.
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

/// Work of reading a cache at a point, in the units of [`work`]: finding the records around it, and interpolating between the four or five that
/// serve it.
const READ_WORK: u64 = 300;

/// Work of looking at one cache record.
const RECORD_WORK: u64 = 4;

/// Work of averaging a cache record with its neighbours, of which it has some 280; the same for every record, so that what a record takes
/// is known when it is gathered.
pub const SMOOTHING_WORK: u64 = 3400;

/// The same by class.
pub const SMOOTHING: WorkByClass = [0, 0, 0, 0, SMOOTHING_WORK];

/// Work: operations weighted by what each takes on a present-day core, in units of about a nanosecond, so that work
/// is close to proportional to time without depending on any clock. The weights are a regression of time on counts over
/// the test scenes; a node's calibration makes seconds of them.
pub fn work(rays: u64, nodes: u64, triangles: u64, shadings: u64, texels: u64) -> u64 {
    60 * rays + 14 * nodes + 5 * triangles + 120 * shadings + 40 * texels
}

/// Work of building a tree: the share of sorting, reinsertion and collapse is close to linear in the triangles.
pub fn build_work(triangles: usize, nodes: usize) -> u64 {
    2000 * triangles as u64 + 500 * nodes as u64
}

/// What some work gives, and the CPU time of this thread that it took, nanoseconds. It must not wait for a thread pool: a thread that
/// waits does other work.
pub fn clocked<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let now = || nanos(rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime));
    let start = now();
    let given = work();
    (given, now() - start)
}

/// CPU time of all threads of this process, nanoseconds.
pub fn process_cpu_nanos() -> u64 {
    nanos(rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime))
}

fn nanos(t: rustix::time::Timespec) -> u64 {
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}
