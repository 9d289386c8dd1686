//! Sums over forecast frames, by stratum.

use crate::estimate::StratumEstimate;
use crate::moments::sum;

/// Totals of one stratum over several frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StratumSum {
    /// Number of pixels that show the stratum.
    pub pixels: u64,
    /// Number of profiled pixels.
    pub samples: u64,
    /// Expected work of all its pixels.
    pub work: f64,
}

impl StratumSum {
    /// One sum per stratum. All frames must have the same strata.
    pub fn over<'a>(frames: impl Iterator<Item = &'a [StratumEstimate]>) -> Vec<Self> {
        let frames: Vec<&[StratumEstimate]> = frames.collect();
        let strata = frames.first().map_or(0, |frame| frame.len());
        (0..strata)
            .map(|h| {
                let own = || frames.iter().filter_map(move |frame| frame.get(h));
                Self {
                    pixels: own().map(|seen| u64::from(seen.pixels)).sum(),
                    samples: own().map(|seen| u64::from(seen.samples)).sum(),
                    work: sum(own().map(|seen| f64::from(seen.pixels) * seen.mean.work)),
                }
            })
            .collect()
    }
}
