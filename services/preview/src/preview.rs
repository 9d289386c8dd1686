//! The preview of a frame, and the shorter answer: how many pixels show what.

use glam::Vec3;
use std::sync::Arc;

/// In [`Preview::stratum`]: the pixel shows no surface.
pub const NOTHING: u32 = u32::MAX;

/// What each pixel of a frame shows at its centre. All lists are row-major from the top-left pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Preview {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Stratum, the index of the (object, material) pair; [`NOTHING`] where no surface is.
    pub stratum: Vec<u32>,
    /// Point on the surface, metres; zero where no surface is.
    pub position: Vec<Vec3>,
    /// Unit geometric normal by the winding, whichever side is seen; zero where no surface is.
    pub normal: Vec<Vec3>,
    /// (object id, material index) by stratum: the frame's [`forelight_scene::Strata`].
    pub pairs: Arc<[(u32, u32)]>,
}

impl Preview {
    /// Object id of a pixel by its row-major index; none where no surface is.
    pub fn object(&self, pixel: usize) -> Option<u32> {
        self.pair(pixel).map(|(object, _)| object)
    }

    /// Material index of a pixel by its row-major index; none where no surface is.
    pub fn material(&self, pixel: usize) -> Option<u32> {
        self.pair(pixel).map(|(_, material)| material)
    }

    /// How many pixels show each stratum: the paper's N_o (section 3).
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

/// How many pixels of a frame show what.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Counts {
    /// Pixels by stratum.
    pub per_stratum: Vec<u32>,
    /// Pixels that show no surface.
    pub background: u32,
}

impl Counts {
    /// No pixel yet, of so many strata.
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

    /// Pixels of the image.
    pub fn pixels(&self) -> u64 {
        self.per_stratum.iter().map(|&n| u64::from(n)).sum::<u64>() + u64::from(self.background)
    }
}
