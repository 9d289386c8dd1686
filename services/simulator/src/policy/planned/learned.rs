//! Corrections of forecasts from finished jobs.

use std::collections::BTreeSet;

/// Weight of the uncorrected forecasts, as a number of jobs.
const TRUST: f64 = 8.0;

#[derive(Clone, Debug, Default)]
pub(super) struct Learned {
    pub counted: BTreeSet<usize>,
    /// log(true work / forecast median), and its forecast standard deviation.
    pub seen: Vec<(f64, f64)>,
}

impl Learned {
    /// Mean logarithmic error of forecasts, shrunk to zero while few jobs are known.
    pub fn shift(&self) -> f64 {
        self.seen.iter().map(|(log, _)| log).sum::<f64>() / (self.seen.len() as f64 + TRUST)
    }

    /// Ratio of actual to forecast spread, at least one.
    pub fn widening(&self) -> f64 {
        let shift = self.shift();
        let squares = |&(log, spread): &(f64, f64)| ((log - shift) / spread) * ((log - shift) / spread);
        let known = self.seen.iter().filter(|(_, spread)| *spread > 0.0);
        let (sum, count) = known.fold((0.0, 0.0), |(sum, count), seen| (sum + squares(seen), count + 1.0));
        libm::sqrt((sum + TRUST) / (count + TRUST)).max(1.0)
    }
}
