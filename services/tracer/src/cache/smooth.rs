//! Smoothing: records that agree, averaged.
//!
//! A record's gather is a sample of a few hundred rays, and what it lacks in rays shows as a fleck as large as the record. Its
//! neighbours have gathered the same light by other rays, and their gradients say what it is here. So every record that is
//! filled takes the weighted mean of what it and its neighbours say of its place, within a wider circle than records are read
//! in: the flecks of several gathers for the price of one, paid once a record instead of at every sample that reads. A neighbour
//! that differs by more than both their noises explain has gathered other light, and counts for less.

use super::places::Places;
use super::{Cache, Level, Record};
use crate::cost::clocked;
use glam::Vec3;
use rayon::prelude::*;

/// Neighbours count as far as their error is below this multiple of the accuracy, seen from either side.
const WIDER: f32 = 6.0;

/// How fast a neighbour's weight falls with what it differs by beyond the noise. The weight of least error would be
/// 1 / (1 + b²/σ²), for a bias b of the neighbour and a variance σ² of either; a single difference d says that b² = d² − 2σ²,
/// but so vaguely that it is believed by a part only. Between a quarter and 1 the image's error hardly changes.
const DISAGREEMENT: f32 = 0.25;

/// What a record says to those that read it.
#[derive(Debug, Clone, Copy)]
pub struct Value {
    pub irradiance: Vec3,
    /// See [`Record::rotation`].
    pub rotation: [Vec3; 3],
    /// See [`Record::translation`].
    pub translation: [Vec3; 3],
    /// See [`Record::trusted`].
    pub trusted: f32,
    /// See [`Record::noise`].
    pub noise: f32,
    /// Whether it is not to be used.
    pub rejected: bool,
}

/// The values of a level.
#[derive(Debug, Clone, Default)]
pub struct Smoothed {
    pub values: Vec<Value>,
    /// The time that averaging them took; the work of it is in the records' own.
    pub cpu_nanos: u64,
    /// Whether all records were filled.
    pub whole: bool,
}

impl Value {
    /// What was gathered, as it is.
    pub fn of(record: &Record) -> Self {
        let Record { irradiance, rotation, translation, trusted, noise, rejected, .. } = *record;
        Self { irradiance, rotation, translation, trusted, noise, rejected }
    }

    /// Whether every number of light is finite.
    pub fn is_finite(&self) -> bool {
        let mut gradients = self.rotation.iter().chain(&self.translation);
        self.irradiance.is_finite() && gradients.all(|gradient| gradient.is_finite())
    }

    /// Irradiance somewhere else, by the gradients: the place lies off by `difference`, metres, and its normal is turned by
    /// `turn` = nᵢ × n. A record's own gradients may change its irradiance at most to this share of it, and to this multiple.
    pub fn at(&self, difference: Vec3, turn: Vec3) -> Vec3 {
        const LEAST: f32 = 0.05;
        const MOST: f32 = 3.0;
        let change = Vec3::from(
            [0, 1, 2]
                .map(|channel| turn.dot(self.rotation[channel]) + difference.dot(self.translation[channel])),
        );
        (self.irradiance + change).clamp(self.irradiance * LEAST, self.irradiance * MOST)
    }
}

impl Cache {
    /// Smooths a level, if all its records are filled, on the current thread pool.
    pub(super) fn smooth(&self, level: usize) {
        if self.is_full(level) {
            self.smooth_filled(level);
        }
    }

    /// Smooths every level all of whose records are filled, on the current thread pool: after parts were merged.
    pub fn smooth_full(&self) {
        (0..self.levels.len()).for_each(|level| self.smooth(level));
    }

    /// Smooths the records of a level that are filled; the others are not to be read from then on.
    pub(super) fn smooth_filled(&self, level: usize) {
        let Some(level) = self.levels.get(level) else { return };
        level.smoothed.get_or_init(|| {
            let all_known = level.known.iter().all(Option::is_some);
            let (places, placing) =
                if all_known { (Places::of(&[]), 0) } else { clocked(|| Places::of(&level.planned)) };
            let smoothed = level.known.par_iter().enumerate().map(|(index, known)| match known {
                Some(value) => (*value, 0),
                None => clocked(|| level.averaged(index, &places, |neighbour| level.gathered(neighbour))),
            });
            let (values, nanos): (Vec<Value>, Vec<u64>) = smoothed.unzip();
            let cpu_nanos = placing + nanos.into_iter().sum::<u64>();
            Smoothed { values, cpu_nanos, whole: level.is_full() }
        });
    }
}

impl Level {
    /// What every record is known to say, one entry for each that is planned: nothing of those that were not smoothed.
    pub(super) fn known_values(&self) -> Vec<Option<Value>> {
        let count = self.planned.len();
        let known = match self.smoothed.get().filter(|smoothed| smoothed.whole) {
            Some(smoothed) => smoothed.values.iter().copied().map(Some).collect(),
            None => self.known.clone(),
        };
        known.into_iter().chain(std::iter::repeat(None)).take(count).collect()
    }

    /// What a record gathered; nothing if it is not filled.
    fn gathered(&self, index: usize) -> Option<Value> {
        self.records[index].get().map(Value::of)
    }

    /// CPU time of smoothing a record, nanoseconds, whether or not those around it are filled: they are taken for as many that
    /// say what it says.
    pub(super) fn smoothing_nanos(&self, index: usize, record: &Record, places: &Places) -> u64 {
        let value = Value::of(record);
        let (averaged, nanos) = clocked(|| self.averaged(index, places, |_| Some(value)));
        // It must not be left out for nobody looking at it.
        std::hint::black_box(averaged);
        nanos
    }

    /// The records that may count when a record is smoothed, itself among them, and how large the larger error is of using one at the
    /// other's place; in any order.
    pub(super) fn neighbours(&self, index: usize, places: &Places) -> impl Iterator<Item = (u32, f32)> {
        let here = &self.planned[index];
        let allowed = self.accuracy * WIDER;
        places.within(here.radius * allowed, here.site.position).filter_map(move |neighbour| {
            let there = &self.planned[neighbour as usize];
            let error = there.error(&here.site, allowed)?.max(here.error(&there.site, allowed)?);
            Some((neighbour, error))
        })
    }

    /// What a record and its neighbours say of its place, each having gathered what `gathered` says.
    fn averaged(&self, index: usize, places: &Places, gathered: impl Fn(usize) -> Option<Value>) -> Value {
        let here = &self.planned[index];
        let Some(own) = gathered(index).filter(|own| !own.rejected) else {
            return Value { rejected: true, ..NOTHING };
        };
        let position = here.site.position;
        let mut neighbours: Vec<(u32, f32)> = self.neighbours(index, places).collect();
        // A sum has one order only.
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
        // Its own weight is 1, so the sum is above 0.
        let mean = |vector: Vec3| vector / weights;
        Value {
            irradiance: mean(sum.irradiance),
            rotation: sum.rotation.map(mean),
            translation: sum.translation.map(mean),
            ..own
        }
    }

    /// How much one record counts at another's place: 1 at the place itself, falling to nothing where either says that the other
    /// is too far off. The one with the smaller radius knows best how fast the light changes between them.
    /// `distance` is in units of the smaller radius within which gradients are trusted.
    fn nearness(&self, error: f32, distance: f32) -> f32 {
        let allowed = self.accuracy * WIDER;
        let near = 1.0 - error / allowed;
        near * near * (1.0 - distance / allowed).max(0.0)
    }
}

/// How far what a neighbour says of a record's place can be explained by their noise: 1 if it can, falling to nothing.
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
