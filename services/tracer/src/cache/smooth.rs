//! Smoothing: averages records that agree.
//!
//! The noise of a gather shows as a blotch as large as the record. So every filled record becomes a weighted
//! mean of its own value and its neighbours' predictions by gradients, over a larger neighbourhood than for
//! reading. A neighbour that differs by more than the noise explains gets a lower weight.

use super::record::{Record, Smoothed, Value};
use super::{Cache, Level};
use crate::cost::clocked;
use glam::Vec3;
use rayon::prelude::*;

/// Neighbours contribute if their error, in both directions, is below this multiple of the accuracy.
const WIDER: f32 = 6.0;

/// How quickly a neighbour's weight falls with a difference beyond the noise. The best weight is 1 / (1 +
/// b²/σ²), for a bias b and a variance σ² of each record. A difference d gives only the rough b² = d² − 2σ²,
/// so it counts in part. The image's error hardly changes between 0.25 and 1.
const DISAGREEMENT: f32 = 0.25;

impl Cache {
    /// Smooths a level on the current thread pool, if all its records are filled.
    pub(super) fn smooth(&self, level: usize) {
        if self.is_full(level) {
            self.smooth_filled(level);
        }
    }

    /// Smooths every full level on the current thread pool. Call it after merging parts.
    pub fn smooth_full(&self) {
        (0..self.levels.len()).for_each(|level| self.smooth(level));
    }

    /// Smooths the filled records of a level. The others must not be read afterwards.
    pub(super) fn smooth_filled(&self, level: usize) {
        let Some(level) = self.levels.get(level) else { return };
        level.smoothed.get_or_init(|| {
            let smoothed = level.known.par_iter().enumerate().map(|(index, known)| match known {
                Some(value) => (*value, 0),
                None => clocked(|| level.averaged(index, |neighbour| level.gathered(neighbour))),
            });
            let (values, nanos): (Vec<Value>, Vec<u64>) = smoothed.unzip();
            let cpu_nanos = nanos.into_iter().sum();
            Smoothed { values, cpu_nanos, whole: level.is_full() }
        });
    }
}

impl Level {
    /// The known smoothed value of each planned record. `None` for records that were not smoothed.
    pub(super) fn known_values(&self) -> Vec<Option<Value>> {
        let count = self.planned.len();
        let known = match self.smoothed.get().filter(|smoothed| smoothed.whole) {
            Some(smoothed) => smoothed.values.iter().copied().map(Some).collect(),
            None => self.known.clone(),
        };
        known.into_iter().chain(std::iter::repeat(None)).take(count).collect()
    }

    /// The gathered value of a record. `None` if it is not filled.
    fn gathered(&self, index: usize) -> Option<Value> {
        self.records[index].get().map(Value::of)
    }

    /// CPU nanoseconds of smoothing a record. Neighbours that are not filled count with the record's value.
    pub(super) fn smoothing_nanos(&self, index: usize, record: &Record) -> u64 {
        let value = Value::of(record);
        let (averaged, nanos) = clocked(|| self.averaged(index, |_| Some(value)));
        // Keep the compiler from removing the computation.
        std::hint::black_box(averaged);
        nanos
    }

    /// The records that may contribute when a record is smoothed, including itself, in any order. Each has
    /// the larger of the two errors of using one at the other.
    pub(super) fn neighbours(&self, index: usize) -> impl Iterator<Item = (u32, f32)> {
        let here = &self.planned[index];
        let allowed = self.accuracy * WIDER;
        self.places().within(here.radius * allowed, here.site.position).filter_map(move |neighbour| {
            let there = &self.planned[neighbour as usize];
            let error = there.error(&here.site, allowed)?.max(here.error(&there.site, allowed)?);
            Some((neighbour, error))
        })
    }

    /// The weighted mean of a record and its neighbours. `gathered` returns the gathered value of a record.
    fn averaged(&self, index: usize, gathered: impl Fn(usize) -> Option<Value>) -> Value {
        let here = &self.planned[index];
        let Some(own) = gathered(index).filter(|own| !own.rejected) else {
            return Value { rejected: true, ..NOTHING };
        };
        let position = here.site.position;
        let mut neighbours: Vec<(u32, f32)> = self.neighbours(index).collect();
        // Sort the neighbours, because the order affects the sum's bits.
        neighbours.sort_unstable_by_key(|(neighbour, _)| *neighbour);
        let (mut sum, mut weights) = (NOTHING, 0.0f32);
        for (neighbour, error) in neighbours {
            let there = &self.planned[neighbour as usize];
            let Some(value) = gathered(neighbour as usize).filter(|value| !value.rejected) else { continue };
            let difference = position - there.site.position;
            let turn = there.site.normal.cross(here.site.normal);
            let said = value.at(difference, turn);
            let trusted = own.trusted.min(value.trusted);
            let weight = self.nearness(error, difference.length() / trusted) * agreement(&own, &value, said);
            sum.irradiance += weight * said;
            for channel in 0..3 {
                sum.rotation[channel] += weight * value.rotation[channel];
                sum.translation[channel] += weight * value.translation[channel];
            }
            weights += weight;
        }
        // The record's own weight is 1, so the sum of the weights is positive.
        let mean = |vector: Vec3| vector / weights;
        Value {
            irradiance: mean(sum.irradiance),
            rotation: sum.rotation.map(mean),
            translation: sum.translation.map(mean),
            ..own
        }
    }

    /// Distance weight of one record at another's site: 1 there, falling to 0. `distance` is in units of the
    /// smaller of the two trusted radii, whose record knows best how quickly the light changes.
    fn nearness(&self, error: f32, distance: f32) -> f32 {
        let allowed = self.accuracy * WIDER;
        let near = 1.0 - error / allowed;
        near * near * (1.0 - distance / allowed).max(0.0)
    }
}

/// How far noise explains a neighbour's difference from the record's value: 1 fully, falling to 0.
fn agreement(own: &Value, neighbour: &Value, said: Vec3) -> f32 {
    let difference = (said - own.irradiance).element_sum() / 3.0;
    let variance = own.noise * own.noise + neighbour.noise * neighbour.noise;
    let beyond = difference * difference / variance.max(f32::MIN_POSITIVE) - 1.0;
    1.0 / (1.0 + DISAGREEMENT * beyond.max(0.0))
}

const NOTHING: Value = Value {
    irradiance: Vec3::ZERO,
    rotation: [Vec3::ZERO; 3],
    translation: [Vec3::ZERO; 3],
    trusted: 0.0,
    noise: 0.0,
    rejected: false,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_neighbour_counts_less_the_less_noise_explains_what_it_says() {
        let value = |level: f32| Value { irradiance: Vec3::splat(level), noise: 0.1, ..NOTHING };
        let counts = |level: f32| agreement(&value(1.0), &value(level), Vec3::splat(level));
        assert_eq!(counts(1.0), 1.0);
        assert_eq!(counts(1.1), 1.0, "within the noise");
        assert!(counts(1.5) < 0.5 && counts(2.0) < 0.1 && counts(f32::MAX) == 0.0);
        let exact = Value { noise: 0.0, ..value(1.0) };
        assert_eq!(agreement(&exact, &exact, exact.irradiance), 1.0);
        assert!(
            agreement(&exact, &exact, Vec3::splat(1.001)) < 1e-6,
            "without noise nothing but the same agrees"
        );
    }
}
