//! What a strategy tells apart of the strata of a preview.

use super::{Strategy, systematic};
use crate::strata::Stratum;

/// The strata that a strategy distinguishes, and which of them each stratum of the preview belongs to.
#[derive(Clone, Debug)]
pub struct Classes {
    /// The strata that the strategy distinguishes.
    pub strata: Vec<Stratum>,
    /// For each stratum of the preview, its index in `strata`.
    pub of: Vec<u32>,
}

impl Classes {
    /// The pixels of each class, given those of each stratum of the preview.
    pub fn counts(&self, counts: &[u32]) -> Vec<u32> {
        let mut sums = vec![0u32; self.strata.len()];
        for (&class, &pixels) in self.of.iter().zip(counts) {
            let sum = &mut sums[class as usize];
            *sum = sum.saturating_add(pixels);
        }
        sums
    }
}

impl Strategy {
    /// What it distinguishes of the strata of a preview. These must be strata of pixels.
    pub fn classes(self, strata: &[Stratum]) -> Classes {
        let (strata, of) = match self {
            Strategy::PaperSnapshot | Strategy::Snapshot => {
                (strata.to_vec(), (0..strata.len() as u32).collect())
            }
            Strategy::Systematic => systematic::classes(strata),
            _ => (vec![Stratum::background(1.0)], vec![0; strata.len()]),
        };
        Classes { strata, of }
    }
}
