//! The cost of a preview, which is part of what a forecast costs.

use std::iter::Sum;
use std::ops::{Add, AddAssign};

/// The cost of a preview.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cost {
    /// Number of BVH nodes visited. Deterministic. 0 on the GPU.
    pub nodes: u64,
    /// Number of triangle tests. Deterministic. 0 on the GPU.
    pub triangles: u64,
    /// CPU nanoseconds of this process's threads, with the build of the tree, without a driver's threads.
    pub cpu_nanos: u64,
    /// Wall-clock nanoseconds spent waiting for the device. 0 on the CPU.
    pub device_nanos: u64,
}

impl Cost {
    /// Time that counts as CPU time, nanoseconds: with the device's, since a software driver runs on the same processor.
    pub fn nanos(&self) -> u64 {
        self.cpu_nanos + self.device_nanos
    }
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
