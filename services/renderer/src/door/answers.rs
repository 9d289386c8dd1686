//! Answers: pixel counts, costs and files.

use super::artefact::Artefact;
use super::part::Region;
use forelight_protocol::PreviewBackend;
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::AddAssign;
use std::path::PathBuf;

/// A cost.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cost {
    /// CPU time of all threads and processes, nanoseconds.
    pub cpu_nanos: u64,
    /// Wall time, nanoseconds.
    pub wall_nanos: u64,
    /// Largest resident memory, bytes.
    pub peak_memory_bytes: u64,
    /// Counters by name, such as `work` or `rays.shadow`.
    #[serde(default)]
    pub counters: BTreeMap<String, u64>,
}

impl AddAssign<&Self> for Cost {
    /// Adds times and counters. Memory is the larger one.
    fn add_assign(&mut self, other: &Self) {
        self.cpu_nanos += other.cpu_nanos;
        self.wall_nanos += other.wall_nanos;
        self.peak_memory_bytes = self.peak_memory_bytes.max(other.peak_memory_bytes);
        for (name, value) in &other.counters {
            *self.counters.entry(name.clone()).or_default() += value;
        }
    }
}

/// Costs that do not depend on the samples, by name, such as `prepare` or `write`. CPU nanoseconds.
pub type FixedCosts = BTreeMap<String, u64>;

/// Number of pixels that show one pair of object and material.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct PixelCount {
    /// Number of the object: by default its index in the description, see
    /// [`Shot::names`](super::Shot::names). `None` for the background.
    pub object: Option<u32>,
    /// Number of the material, likewise. `None` without material.
    pub material: Option<u32>,
    /// Number of pixels.
    pub pixels: u64,
}

/// What a frame shows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameCounts {
    /// Number of the frame.
    pub frame: i32,
    /// Pixels by stratum, in the order of (object, material). They add up to the image's pixels, within
    /// rounding where the preview was smaller than the image.
    pub counts: Vec<PixelCount>,
    /// Number of pixels of the preview itself.
    pub sampled_pixels: u64,
    /// How it was made.
    pub backend: PreviewBackend,
    /// Cost of the preview.
    pub cost: Cost,
}

/// Cost of one stratum within a measured part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct StratumCost {
    /// Its pixels.
    #[serde(flatten)]
    pub count: PixelCount,
    /// Time spent on them, nanoseconds. It tells how the cost divides; the CPU time tells how much it is.
    pub nanos: u64,
}

/// Where in the image time goes: sums over square blocks, in rows from the top.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BlockCosts {
    /// Side of a block, pixels. Blocks at the right and lower edge may be smaller.
    pub side: u32,
    /// Blocks in a row.
    pub columns: u32,
    /// Nanoseconds of each block.
    pub nanos: Vec<u64>,
}

impl BlockCosts {
    /// Mean nanoseconds of the pixels of its block, for each pixel of an image of this size, in rows from the
    /// top.
    pub fn of_pixels(&self, width: u32, height: u32) -> Vec<f64> {
        let side = self.side.max(1);
        // The last block of a row or a column may be smaller.
        let length = |at: u32, all: u32| f64::from(side.min(all - at / side * side));
        let of_pixel = |x: u32, y: u32| {
            let block = y / side * self.columns + x / side;
            let nanos = self.nanos.get(block as usize).copied().unwrap_or(0);
            nanos as f64 / (length(x, width) * length(y, height))
        };
        (0..height).flat_map(|y| (0..width).map(move |x| of_pixel(x, y))).collect()
    }
}

/// Cost of one of several pieces that were measured one by one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PieceCost {
    /// The piece. A pixel is a region of one.
    pub region: Region,
    /// CPU time, nanoseconds.
    pub cpu_nanos: u64,
}

/// The cost of a part of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Cost of the part, with what is in `fixed`.
    pub cost: Cost,
    /// What of it does not depend on the samples, as far as the renderer knows.
    pub fixed: FixedCosts,
    /// Costs piece by piece, for regions and pixels.
    pub pieces: Vec<PieceCost>,
    /// Costs by stratum. Empty if not known.
    pub strata: Vec<StratumCost>,
    /// Costs by place. `None` if not known.
    pub blocks: Option<BlockCosts>,
    /// Object and material of each pixel as a colour. `None` if the renderer does not know them.
    pub ids: Option<RgbImage>,
    /// What a render may take over.
    pub artefact: Option<Artefact>,
    /// For a share of the samples of a frame whose pixels stop by their noise: how many they take. `None`: all.
    pub stopping: Option<Stopping>,
}

/// How many samples pixels take if each stops by its noise. The share beside it was measured without stopping.
#[derive(Debug, Clone, PartialEq)]
pub struct Stopping {
    /// Mean number of samples of a pixel, weighted by what a sample of it costs.
    pub samples: f64,
    /// What it cost to find that out.
    pub cost: Cost,
}

impl Measured {
    /// CPU time that depends on the samples, nanoseconds.
    pub fn sample_nanos(&self) -> u64 {
        self.cost.cpu_nanos.saturating_sub(self.fixed.values().sum())
    }
}

/// What a render took over of single pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TakenOver {
    /// Number of pixels.
    pub pixels: u64,
    /// CPU time that they took when they were measured, nanoseconds.
    pub cpu_nanos: u64,
}

/// A rendered frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rendered {
    /// Images and other results. The first is the image with linear values, as OpenEXR where the renderer
    /// writes it.
    pub files: Vec<PathBuf>,
    /// The image for viewing. `None` if the first file is in a format that everyone can read.
    pub picture: Option<RgbImage>,
    /// Object and material of each pixel as a colour. `None` if the renderer does not know them.
    pub ids: Option<RgbImage>,
    /// Cost of this render, without what it took over.
    pub cost: Cost,
    /// What of it does not depend on the samples.
    pub fixed: FixedCosts,
    /// Costs by stratum of the whole frame, with what was taken over.
    pub strata: Vec<StratumCost>,
    /// Costs by place of the whole frame, with what was taken over.
    pub blocks: Option<BlockCosts>,
    /// Pixels that were taken over. Shares of the samples are not in it: the task states their cost.
    pub taken_over: TakenOver,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_share_the_time_of_their_block_also_where_it_is_smaller() {
        // Blocks of 4 × 4, 1 × 4, 4 × 2 and 1 × 2 pixels.
        let blocks = BlockCosts { side: 4, columns: 2, nanos: vec![160, 8, 24, 6] };
        let costs = blocks.of_pixels(5, 6);
        assert_eq!(costs.len(), 30);
        assert_eq!([costs[0], costs[4], costs[20], costs[29]], [10.0, 2.0, 3.0, 3.0]);
        assert_eq!(costs.iter().sum::<f64>(), 198.0);
    }
}
