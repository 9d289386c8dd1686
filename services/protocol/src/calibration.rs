//! How fast machines are, by class of work.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Work by what is done. Work is counted in operations that take about a nanosecond each on a present-day core; how long they
/// really take differs between machines, and between classes on one machine.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ByClass {
    /// What comes with every ray: random numbers, directions, setting it up.
    pub rays: u64,
    /// Going through a tree that fits into the processor's caches.
    pub traversal: u64,
    /// Going through one that does not.
    pub memory: u64,
    /// What surfaces do with light.
    pub shading: u64,
    /// Looking up images.
    pub texture: u64,
    /// Records of the irradiance cache.
    pub records: u64,
    /// Building the tree, for frames in which something moves.
    #[serde(default)]
    pub build: u64,
}

impl ByClass {
    /// Names of the classes, in the order of [`Self::to_array`].
    pub const NAMES: [&'static str; ByClass::CLASSES] =
        ["rays", "traversal", "memory", "shading", "texture", "records", "build"];

    /// How many classes there are.
    pub const CLASSES: usize = 7;

    /// The numbers in the order of [`Self::NAMES`].
    pub const fn to_array(self) -> [u64; ByClass::CLASSES] {
        let Self { rays, traversal, memory, shading, texture, records, build } = self;
        [rays, traversal, memory, shading, texture, records, build]
    }

    /// The numbers from an array in the order of [`Self::NAMES`].
    pub const fn from_array(classes: [u64; ByClass::CLASSES]) -> Self {
        let [rays, traversal, memory, shading, texture, records, build] = classes;
        Self { rays, traversal, memory, shading, texture, records, build }
    }

    /// Class by class the sum.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        let (own, other) = (self.to_array(), other.to_array());
        Self::from_array(std::array::from_fn(|class| own[class].saturating_add(other[class])))
    }

    /// All classes together.
    pub fn total(self) -> u64 {
        self.to_array().into_iter().fold(0, u64::saturating_add)
    }
}

/// What a kernel of the calibration took.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct KernelTime {
    /// Its name: 1 to 50 characters.
    #[schema(min_length = 1, max_length = 50)]
    pub name: String,
    /// Its work, the same on every machine.
    pub work: ByClass,
    /// CPU time of one core for it, nanoseconds: the shortest of many rounds.
    pub cpu_nanos: u64,
}

/// How fast one core of a machine is, as `forelight calibrate` measures it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeCalibration {
    /// Picoseconds for a unit of work of each class: 1 to 1,000,000,000. Without `build`, which is then taken to be as `memory`.
    pub picos_per_work: ByClass,
    /// What they were found with.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 20)]
    pub kernels: Vec<KernelTime>,
}

impl NodeCalibration {
    /// Kernels of a calibration at most.
    pub const MOST_KERNELS: usize = 20;

    /// Picoseconds for a unit of work of each class. Sorting triangles into a tree waits for memory, so that is what it is like where it was not measured.
    fn rates(&self) -> [u64; ByClass::CLASSES] {
        let ByClass { memory, build, .. } = self.picos_per_work;
        let build = if build == 0 { memory } else { build };
        ByClass { build, ..self.picos_per_work }.to_array()
    }

    /// Picoseconds of one core for this work.
    fn picos(&self, work: &ByClass) -> u128 {
        let classes = work.to_array().into_iter().zip(self.rates());
        classes.map(|(work, picos)| u128::from(work) * u128::from(picos)).sum()
    }

    /// Seconds of one core for this work.
    pub fn seconds(&self, work: &ByClass) -> f64 {
        self.picos(work) as f64 * 1e-12
    }

    /// Speed for such work against the reference, a core that takes a nanosecond for every unit; `None` if there is no work.
    pub fn speed(&self, work: &ByClass) -> Option<f64> {
        let (reference, own) = (1000 * u128::from(work.total()), self.picos(work));
        (reference > 0 && own > 0).then(|| reference as f64 / own as f64)
    }

    /// Whether all numbers are in their ranges.
    ///
    /// # Errors
    /// With the field and the reason.
    pub fn check(&self) -> Result<(), (&'static str, &'static str)> {
        if self.rates().into_iter().any(|picos| !(1..=1_000_000_000).contains(&picos)) {
            return Err(("picos_per_work", "must each lie in 1 to 1000000000"));
        }
        if self.kernels.len() > Self::MOST_KERNELS {
            return Err(("kernels", "must be 20 at most"));
        }
        if self.kernels.iter().any(|kernel| !(1..=50).contains(&kernel.name.chars().count())) {
            return Err(("kernels", "must have names of 1 to 50 characters"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_that_is_slow_in_one_class_is_slow_where_that_is_what_is_done() {
        let picos_per_work = ByClass { memory: 4000, ..ByClass::from_array([1000; ByClass::CLASSES]) };
        let node = NodeCalibration { picos_per_work, kernels: Vec::new() };
        let small = ByClass { traversal: 300, shading: 100, ..ByClass::default() };
        let large = ByClass { memory: 300, shading: 100, ..ByClass::default() };
        assert_eq!(node.speed(&small), Some(1.0));
        assert_eq!(node.speed(&large), Some(400.0 / 1300.0));
        assert_eq!(node.speed(&ByClass::default()), None);
        assert!(node.check().is_ok());
        let unmeasured = NodeCalibration { picos_per_work: ByClass { build: 0, ..picos_per_work }, ..node };
        assert!(unmeasured.check().is_ok());
        let built = ByClass { build: 100, ..ByClass::default() };
        assert_eq!((unmeasured.seconds(&built), unmeasured.speed(&built)), (400e-9, Some(0.25)));
        let stopped = NodeCalibration { picos_per_work: ByClass::default(), kernels: Vec::new() };
        assert_eq!(stopped.check().unwrap_err().0, "picos_per_work");
    }
}
