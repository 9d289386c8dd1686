//! The records of an irradiance cache, as strata. Their number is known from planning; the cost of gathering
//! one is learnt from a few.

use crate::cost::{Cost, Observation};
use crate::population::FramePopulation;
use crate::strata::Stratum;

/// The position of the cache records in a list of strata.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordStrata {
    first: u32,
}

impl RecordStrata {
    /// Adds strata for the cache records after the last stratum, which must be the background, and their
    /// numbers to every frame's counts. `records[t][level]` is the number of records of a level in frame t.
    /// Each has `prior_cost`.
    pub fn add(
        strata: &mut Vec<Stratum>,
        frames: &mut [FramePopulation],
        records: &[&[u32]],
        prior_cost: f64,
    ) -> Self {
        let first = strata.len();
        let levels = records.iter().map(|levels| levels.len()).max().unwrap_or(0);
        strata.extend(Stratum::of_records(levels, prior_cost));
        for (frame, records) in frames.iter_mut().zip(records) {
            frame.counts.extend_from_slice(records);
            frame.counts.resize(first + levels, 0);
        }
        Self { first: first as u32 }
    }

    /// The observation that gathering one record of `level` cost `cost`.
    pub fn observation(self, level: u32, cost: Cost) -> Observation {
        Observation { stratum: self.first.saturating_add(level), cost }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_of_any_frame_has_a_stratum_and_every_frame_a_number_for_it() {
        let mut strata = vec![Stratum::background(0.1)];
        let mut frames = [3, 4]
            .map(|number| FramePopulation {
                number,
                counts: vec![number as u32],
                lights: 0,
                shining: 0,
                triangles: 0,
            })
            .to_vec();
        let records = RecordStrata::add(&mut strata, &mut frames, &[&[], &[700, 90]], 48.0);
        assert_eq!(frames.iter().map(|f| &f.counts[..]).collect::<Vec<_>>(), [&[3, 0, 0], &[4, 700, 90]]);
        assert!(strata[1..].iter().all(|stratum| stratum.apart && stratum.prior_cost == 48.0));
        assert_ne!(strata[1].object, strata[2].object);
        assert_eq!(records.observation(1, Cost::default()).stratum, 2);
    }

    #[test]
    fn without_a_cache_nothing_is_added() {
        let mut strata = vec![Stratum::background(0.1)];
        let mut frames =
            vec![FramePopulation { number: 0, counts: vec![9], lights: 0, shining: 0, triangles: 0 }];
        RecordStrata::add(&mut strata, &mut frames, &[&[]], 1.0);
        assert_eq!((strata.len(), &frames[0].counts[..]), (1, &[9][..]));
    }
}
