//! How many rounds fill a shared irradiance cache, how far it is, and what follows each round.

use forelight_protocol::{CACHE_ROUNDS, SharedCacheForecast, SharedCacheProgress};

/// Levels of a cache that have records, from the number of records of each level.
fn levels(records: &[u32]) -> u32 {
    u32::try_from(records.iter().filter(|&&records| records > 0).count()).unwrap_or(u32::MAX)
}

/// In how many rounds a cache is filled. A cache of one part is filled by one task, all levels at once.
/// Several parts fill one level after the other. Levels without records need no round.
fn rounds(parts: u32, levels: u32) -> u32 {
    if parts > 1 { levels.max(1) } else { 1 }
}

/// How far one part of a cache is.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct PartDone {
    /// The share of the part whose rounds are done, 0 to 1.
    pub done: f64,
    /// The same with what the worker has done of the present round.
    pub with_worker: f64,
}

/// How far a part is of a cache with so many parts and levels: its present round, from 0, whether that round
/// is filled, and how far its worker is, 0 to 1.
pub(crate) fn part_done((parts, levels): (u32, u32), round: u32, is_filled: bool, progress: f64) -> PartDone {
    let rounds = f64::from(rounds(parts, levels));
    let done = (f64::from(round + u32::from(is_filled)) / rounds).min(1.0);
    PartDone { done, with_worker: (done + progress / rounds).min(1.0) }
}

/// What the tasks of a shared cache have done so far.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub(crate) struct Filled {
    /// Parts that are filled, over all rounds.
    pub parts_done: u32,
    /// The same with the progress of those under way.
    pub reached: f64,
    /// Whether the frames can be rendered.
    pub is_ready: bool,
    /// Work of the parts that are filled.
    pub work: f64,
    /// CPU nanoseconds of the same and of merging, at speed 1.
    pub cpu_nanos: f64,
}

/// How far a cache is that was forecast so.
pub(crate) fn progress(forecast: &SharedCacheForecast, filled: &Filled) -> SharedCacheProgress {
    let rounds = rounds(forecast.parts, levels(&forecast.records));
    let parts = forecast.parts.saturating_mul(rounds).max(1);
    SharedCacheProgress {
        parts,
        parts_done: filled.parts_done,
        progress: (filled.reached / f64::from(parts)).clamp(0.0, 1.0),
        ready: filled.is_ready,
        // The conversion saturates.
        work: filled.work as u64,
        cpu_seconds: filled.cpu_nanos * 1e-9,
    }
}

/// What follows a round.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Next {
    /// The cache is full: the frames are ready.
    Frames,
    /// This round is filled next.
    Round(u32),
    /// The cache should have been full by now: the job fails with this error.
    GiveUp(String),
}

/// What follows this round, from 0, after which the cache is full or not.
pub(crate) fn after_round(round: u32, is_full: bool) -> Next {
    if is_full {
        Next::Frames
    } else if round + 1 < CACHE_ROUNDS {
        Next::Round(round + 1)
    } else {
        Next::GiveUp(format!("the irradiance cache is not full after {CACHE_ROUNDS} rounds of filling it"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_parts_fill_one_level_after_the_other_and_one_part_fills_all_at_once() {
        let parts = |parts, records: &[u32]| {
            let records = records.to_vec();
            let forecast = SharedCacheForecast {
                records,
                parts,
                work: Default::default(),
                cpu_seconds: Default::default(),
                cost: None,
            };
            progress(&forecast, &Filled::default()).parts
        };
        assert_eq!((parts(1, &[5, 3]), parts(3, &[5, 3]), parts(3, &[5, 0])), (1, 6, 3));
    }

    #[test]
    fn a_part_is_as_far_as_its_rounds_and_its_worker() {
        let at = |round, is_filled, progress| part_done((3, 2), round, is_filled, progress);
        assert_eq!(at(0, false, 0.5), PartDone { done: 0.0, with_worker: 0.25 });
        assert_eq!(at(1, false, 0.0), PartDone { done: 0.5, with_worker: 0.5 });
        assert_eq!(at(1, true, 1.0), PartDone { done: 1.0, with_worker: 1.0 });
    }

    #[test]
    fn a_cache_that_is_never_full_is_given_up() {
        assert_eq!(after_round(0, true), Next::Frames);
        assert_eq!(after_round(0, false), Next::Round(1));
        assert!(matches!(after_round(CACHE_ROUNDS - 1, false), Next::GiveUp(_)));
    }
}
