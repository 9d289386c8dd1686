//! The preview of a frame, and its pixel counts.

use glam::Vec3;
use std::sync::Arc;

/// Value in [`Preview::stratum`] for a pixel that shows no surface.
pub const NOTHING: u32 = u32::MAX;

/// What each pixel of a frame shows at its centre. All lists are in row order from the top-left pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Preview {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Stratum of each pixel: the index of its (object, material) pair. [`NOTHING`] where no surface is.
    pub stratum: Vec<u32>,
    /// Point on the surface, in metres. Zero where no surface is.
    pub position: Vec<Vec3>,
    /// Geometric unit normal by the triangle's winding. Zero where no surface is.
    pub normal: Vec<Vec3>,
    /// (object id, material index) of each stratum, from the frame's [`forelight_scene::Strata`].
    pub pairs: Arc<[(u32, u32)]>,
}

impl Preview {
    /// Object id of a pixel, by its index in row order. `None` where no surface is.
    pub fn object(&self, pixel: usize) -> Option<u32> {
        self.pair(pixel).map(|(object, _)| object)
    }

    /// Material index of a pixel, by its index in row order. `None` where no surface is.
    pub fn material(&self, pixel: usize) -> Option<u32> {
        self.pair(pixel).map(|(_, material)| material)
    }

    /// Number of pixels of each stratum: N_o in the paper (section 3).
    pub fn counts(&self) -> Counts {
        let mut counts = Counts::none(self.pairs.len());
        for &stratum in &self.stratum {
            counts.add(stratum);
        }
        counts
    }

    fn pair(&self, pixel: usize) -> Option<(u32, u32)> {
        self.pairs.get(*self.stratum.get(pixel)? as usize).copied()
    }
}

/// Pixel counts of a frame.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Counts {
    /// Number of pixels of each stratum.
    pub per_stratum: Vec<u32>,
    /// Number of pixels that show no surface.
    pub background: u32,
}

impl Counts {
    /// Counts of zero for `strata` strata.
    pub(crate) fn none(strata: usize) -> Self {
        Self { per_stratum: vec![0; strata], background: 0 }
    }

    pub(crate) fn add(&mut self, stratum: u32) {
        match self.per_stratum.get_mut(stratum as usize) {
            Some(count) => *count += 1,
            None => self.background += 1,
        }
    }

    /// The sum of two counts over the same strata.
    pub(crate) fn plus(mut self, other: &Self) -> Self {
        for (a, b) in self.per_stratum.iter_mut().zip(&other.per_stratum) {
            *a += b;
        }
        self.background += other.background;
        self
    }

    /// Number of pixels of the image.
    pub fn pixels(&self) -> u64 {
        self.per_stratum.iter().map(|&n| u64::from(n)).sum::<u64>() + u64::from(self.background)
    }
}
