//! Speed of machines, by class of work.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Work by class. An operation takes about a nanosecond, depending on the machine and the class.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ByClass {
    /// Setting up each ray: random numbers and directions.
    pub rays: u64,
    /// Traversal of an acceleration structure that fits into the processor's caches.
    pub traversal: u64,
    /// Traversal of an acceleration structure that does not fit into the processor's caches.
    pub memory: u64,
    /// Reflection and transmission of light at surfaces.
    pub shading: u64,
    /// Texture lookups.
    pub texture: u64,
    /// Lookups of irradiance cache records.
    pub records: u64,
    /// Building the acceleration structure, for frames in which something moves.
    #[serde(default)]
    pub build: u64,
}

impl ByClass {
    /// Names of the classes, in the order of [`Self::to_array`].
    pub const NAMES: [&'static str; ByClass::CLASSES] =
        ["rays", "traversal", "memory", "shading", "texture", "records", "build"];

    /// Number of classes.
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

    /// The sum, class by class. Saturating.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        let (own, other) = (self.to_array(), other.to_array());
        Self::from_array(std::array::from_fn(|class| own[class].saturating_add(other[class])))
    }

    /// The sum over all classes. Saturating.
    pub fn total(self) -> u64 {
        self.to_array().into_iter().fold(0, u64::saturating_add)
    }
}

/// Measured time of one calibration kernel.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct KernelTime {
    /// Name of the kernel: 1 to 50 characters.
    #[schema(min_length = 1, max_length = 50)]
    pub name: String,
    /// Work of the kernel. It is the same on every machine.
    pub work: ByClass,
    /// CPU time on one core in nanoseconds: the minimum over many rounds.
    pub cpu_nanos: u64,
}

/// Speed of one core of a machine, as measured by `forelight calibrate`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeCalibration {
    /// Picoseconds per unit of work of each class: 1 to 1,000,000,000. A `build` of 0 means that of `memory`.
    pub picos_per_work: ByClass,
    /// The kernel times behind these numbers, at most 20.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 20)]
    pub kernels: Vec<KernelTime>,
}

impl NodeCalibration {
    /// Largest number of kernels.
    pub const MOST_KERNELS: usize = 20;

    /// Picoseconds per unit of work of each class. An unmeasured `build` takes the value of `memory`.
    fn rates(&self) -> [u64; ByClass::CLASSES] {
        let ByClass { memory, build, .. } = self.picos_per_work;
        let build = if build == 0 { memory } else { build };
        ByClass { build, ..self.picos_per_work }.to_array()
    }

    /// Picoseconds that one core needs for this work.
    fn picos(&self, work: &ByClass) -> u128 {
        let classes = work.to_array().into_iter().zip(self.rates());
        classes.map(|(work, picos)| u128::from(work) * u128::from(picos)).sum()
    }

    /// Seconds that one core needs for this work.
    pub fn seconds(&self, work: &ByClass) -> f64 {
        self.picos(work) as f64 * 1e-12
    }

    /// Speed for this mix of work; 1 is a nanosecond per unit. `None` without work.
    pub fn speed(&self, work: &ByClass) -> Option<f64> {
        let (reference, own) = (1000 * u128::from(work.total()), self.picos(work));
        (reference > 0 && own > 0).then(|| reference as f64 / own as f64)
    }

    /// Checks that all numbers are within their ranges. The error is the field's name and the reason.
    pub fn check(&self) -> Result<(), (&'static str, &'static str)> {
        if self.rates().into_iter().any(|picos| !(1..=1_000_000_000).contains(&picos)) {
            return Err(("picos_per_work", "must each be 1 to 1000000000"));
        }
        if self.kernels.len() > Self::MOST_KERNELS {
            return Err(("kernels", "must be at most 20"));
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
