//! What a preview took: its part of what a forecast has spent.

use std::iter::Sum;
use std::ops::{Add, AddAssign};

/// What a preview took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cost {
    /// BVH nodes visited; 0 on the GPU. Deterministic.
    pub nodes: u64,
    /// Triangle tests; 0 on the GPU. Deterministic.
    pub triangles: u64,
    /// CPU time of this process's threads, summed, with the build of the tree, nanoseconds.
    /// A Vulkan driver's own threads are not in it.
    pub cpu_nanos: u64,
    /// Time spent waiting for the device, nanoseconds of wall clock; 0 on the CPU. With a driver that renders in software the
    /// device is the same processor.
    pub device_nanos: u64,
}

impl Add for Cost {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            nodes: self.nodes + other.nodes,
            triangles: self.triangles + other.triangles,
            cpu_nanos: self.cpu_nanos + other.cpu_nanos,
            device_nanos: self.device_nanos + other.device_nanos,
        }
    }
}

impl AddAssign for Cost {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sum for Cost {
    fn sum<I: Iterator<Item = Self>>(costs: I) -> Self {
        costs.fold(Self::default(), Add::add)
    }
}
