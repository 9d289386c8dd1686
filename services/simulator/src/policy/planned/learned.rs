//! What is learned of forecasts as jobs are finished.

use std::collections::BTreeSet;

/// So many jobs' worth of trust are in the forecasts before any job was seen.
const TRUST: f64 = 8.0;

/// What finished jobs say about forecasts.
#[derive(Clone, Debug, Default)]
pub(super) struct Learned {
    pub counted: BTreeSet<usize>,
    /// Logarithm of true over forecast median, and the forecast's standard deviation of it.
    pub seen: Vec<(f64, f64)>,
}

impl Learned {
    /// By how much forecasts are off, as a logarithm: the mean, drawn towards nothing while few jobs were seen.
    pub fn shift(&self) -> f64 {
        self.seen.iter().map(|(log, _)| log).sum::<f64>() / (self.seen.len() as f64 + TRUST)
    }

    /// How many times wider errors are than forecast; at least one.
    pub fn widening(&self) -> f64 {
        let shift = self.shift();
        let squares = |&(log, spread): &(f64, f64)| ((log - shift) / spread) * ((log - shift) / spread);
        let known = self.seen.iter().filter(|(_, spread)| *spread > 0.0);
        let (sum, count) = known.fold((0.0, 0.0), |(sum, count), seen| (sum + squares(seen), count + 1.0));
        libm::sqrt((sum + TRUST) / (count + TRUST)).max(1.0)
    }
}
