//! Animation curves: keyframes and the interpolation between them. Time is in frames; the value is constant
//! outside the keys.
//!
//! *Catmull–Rom* is a cubic Hermite spline with the tangent mᵢ = (pᵢ₊₁ − pᵢ₋₁) / (tᵢ₊₁ − tᵢ₋₁), at both ends
//! the slope of the segment. With s = (t − tᵢ)/Δ and Δ = tᵢ₊₁ − tᵢ:
//!
//! ```text
//! p(t) = (2s³−3s²+1)·pᵢ + (s³−2s²+s)·Δ·mᵢ + (3s²−2s³)·pᵢ₊₁ + (s³−s²)·Δ·mᵢ₊₁
//! ```
//!
//! Rotations are interpolated by component in the same hemisphere, then normalised.

use glam::{DQuat, DVec3, DVec4};
use serde::{Deserialize, Serialize};

/// A value that can be interpolated between keys.
pub(crate) trait Keyed: Copy + PartialEq {
    /// Linear interpolation, or spherical linear interpolation for rotations. `s` is in [0, 1].
    fn linear(a: Self, b: Self, s: f64) -> Self;
    /// Weighted sum. Rotations are normalised afterwards.
    fn sum(terms: [(f64, Self); 4]) -> Self;
    /// The tangent `(b − a) × scale`.
    fn slope(a: Self, b: Self, scale: f64) -> Self;
    /// A tangent converted to another unit of time.
    fn scaled(self, factor: f64) -> Self;
    /// The representation of `next` nearest to `previous`: for quaternions, q and −q are the same rotation.
    fn aligned(_previous: Self, next: Self) -> Self {
        next
    }
}

impl Keyed for f64 {
    fn linear(a: Self, b: Self, s: f64) -> Self {
        a + (b - a) * s
    }
    fn sum(terms: [(f64, Self); 4]) -> Self {
        terms.iter().map(|(w, v)| w * v).sum()
    }
    fn slope(a: Self, b: Self, scale: f64) -> Self {
        (b - a) * scale
    }
    fn scaled(self, factor: f64) -> Self {
        self * factor
    }
}

impl Keyed for DVec3 {
    fn linear(a: Self, b: Self, s: f64) -> Self {
        a + (b - a) * s
    }
    fn sum(terms: [(f64, Self); 4]) -> Self {
        terms.iter().map(|&(w, v)| v * w).sum()
    }
    fn slope(a: Self, b: Self, scale: f64) -> Self {
        (b - a) * scale
    }
    fn scaled(self, factor: f64) -> Self {
        self * factor
    }
}

impl Keyed for DQuat {
    /// Spherical linear interpolation along the shortest arc, by `libm` for the same bits everywhere.
    fn linear(a: Self, b: Self, s: f64) -> Self {
        let b = Self::aligned(a, b);
        let cosine = a.dot(b).min(1.0);
        // At such small angles the sine loses its digits. The chord is then as good as the arc.
        if cosine > 1.0 - 1e-9 {
            return Self::sum([(1.0 - s, a), (s, b), (0.0, a), (0.0, b)]);
        }
        let angle = libm::acos(cosine);
        let (wa, wb) = (libm::sin((1.0 - s) * angle), libm::sin(s * angle));
        Self::sum([(wa, a), (wb, b), (0.0, a), (0.0, b)])
    }
    fn sum(terms: [(f64, Self); 4]) -> Self {
        let v: DVec4 = terms.iter().map(|&(w, q)| DVec4::from(q) * w).sum();
        // The four terms can cancel out. Any rotation is then valid; use that of the first key.
        v.try_normalize().map_or(terms[0].1, DQuat::from_vec4)
    }
    fn slope(a: Self, b: Self, scale: f64) -> Self {
        DQuat::from_vec4((DVec4::from(b) - DVec4::from(a)) * scale)
    }
    fn scaled(self, factor: f64) -> Self {
        self * factor
    }
    fn aligned(previous: Self, next: Self) -> Self {
        if previous.dot(next) < 0.0 { -next } else { next }
    }
}

/// The interpolation between two keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Interpolation {
    Step,
    Linear,
    CatmullRom,
}

/// A value as a function of time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Curve<T> {
    /// Key times in frames, ascending, at least one.
    times: Vec<f64>,
    values: Vec<T>,
    between: Between<T>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Between<T> {
    Step,
    Linear,
    /// Arriving and leaving tangent of each key, per frame.
    Hermite(Vec<(T, T)>),
}

impl<T: Keyed> Curve<T> {
    /// A curve through keys at ascending times. `None` without keys, or with unequal numbers.
    pub(crate) fn new(times: Vec<f64>, mut values: Vec<T>, interpolation: Interpolation) -> Option<Self> {
        if times.is_empty() || times.len() != values.len() {
            return None;
        }
        let between = match interpolation {
            Interpolation::Step => Between::Step,
            Interpolation::Linear => Between::Linear,
            Interpolation::CatmullRom => {
                for i in 1..values.len() {
                    values[i] = T::aligned(values[i - 1], values[i]);
                }
                let last = values.len() - 1;
                let tangent = |i: usize| {
                    let (a, b) = (i.saturating_sub(1), (i + 1).min(last));
                    let span = times[b] - times[a];
                    let tangent = T::slope(values[a], values[b], if span > 0.0 { 1.0 / span } else { 0.0 });
                    (tangent, tangent)
                };
                Between::Hermite((0..values.len()).map(tangent).collect())
            }
        };
        Some(Self { times, values, between })
    }

    /// A cubic curve with the given (arriving, leaving) tangents per frame, as in glTF.
    pub(crate) fn hermite(times: Vec<f64>, values: Vec<T>, tangents: Vec<(T, T)>) -> Option<Self> {
        let matching = !times.is_empty() && times.len() == values.len() && times.len() == tangents.len();
        matching.then_some(Self { times, values, between: Between::Hermite(tangents) })
    }

    /// The value at a frame, which may be fractional.
    pub(crate) fn at(&self, frame: f64) -> T {
        let next = self.times.partition_point(|&t| t <= frame);
        if next == 0 {
            return self.values[0];
        }
        let i = next - 1;
        if next == self.times.len() {
            return self.values[i];
        }
        let span = self.times[next] - self.times[i];
        let s = (frame - self.times[i]) / span;
        match &self.between {
            Between::Step => self.values[i],
            Between::Linear => T::linear(self.values[i], self.values[next], s),
            Between::Hermite(tangents) => {
                let (s2, s3) = (s * s, s * s * s);
                T::sum([
                    (2.0 * s3 - 3.0 * s2 + 1.0, self.values[i]),
                    ((s3 - 2.0 * s2 + s) * span, tangents[i].1),
                    (3.0 * s2 - 2.0 * s3, self.values[next]),
                    ((s3 - s2) * span, tangents[next].0),
                ])
            }
        }
    }

    /// Returns `true` if the value is the same at all times.
    pub(crate) fn is_constant(&self) -> bool {
        let same = self.values.iter().all(|v| *v == self.values[0]);
        let flat = match &self.between {
            Between::Hermite(tangents) => {
                let none = T::slope(self.values[0], self.values[0], 0.0);
                self.values.len() == 1 || tangents.iter().all(|t| t.0 == none && t.1 == none)
            }
            Between::Step | Between::Linear => true,
        };
        same && flat
    }
}

/// A constant value or a curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Animated<T> {
    Constant(T),
    Curve(Curve<T>),
}

impl<T: Keyed> Animated<T> {
    pub(crate) fn at(&self, frame: f64) -> T {
        match self {
            Animated::Constant(value) => *value,
            Animated::Curve(curve) => curve.at(frame),
        }
    }

    pub(crate) fn is_constant(&self) -> bool {
        match self {
            Animated::Constant(_) => true,
            Animated::Curve(curve) => curve.is_constant(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stay_before_the_first_and_after_the_last_key() {
        let curve = Curve::new(vec![2.0, 4.0], vec![1.0, 3.0], Interpolation::Linear).unwrap();
        assert_eq!((curve.at(0.0), curve.at(2.0), curve.at(3.0), curve.at(9.0)), (1.0, 1.0, 2.0, 3.0));
    }

    #[test]
    fn a_step_holds_until_the_next_key_is_reached() {
        let curve = Curve::new(vec![0.0, 10.0], vec![1.0, 2.0], Interpolation::Step).unwrap();
        assert_eq!((curve.at(9.999), curve.at(10.0)), (1.0, 2.0));
    }

    #[test]
    fn catmull_rom_with_unequal_keys_follows_the_documented_formula() {
        let curve = Curve::new(vec![0.0, 2.0, 3.0], vec![0.0, 4.0, 10.0], Interpolation::CatmullRom).unwrap();
        // First segment, s = 1/2: tangents 4/2 = 2 and 10/3, Δ = 2: 4/2 + (2 − 10/3)·2/8 = 2 − 1/3.
        assert!((curve.at(1.0) - (2.0 - 1.0 / 3.0)).abs() < 1e-14);
        // Second segment, s = 1/2: (4 + 10)/2 + (10/3 − 6)/8 = 7 − 1/3.
        assert!((curve.at(2.5) - (7.0 - 1.0 / 3.0)).abs() < 1e-14);
        assert_eq!((curve.at(0.0), curve.at(2.0), curve.at(3.0)), (0.0, 4.0, 10.0));
    }

    #[test]
    fn catmull_rom_through_a_line_is_the_line() {
        let times = vec![0.0, 1.0, 5.0, 7.0];
        let curve = Curve::new(times.clone(), times, Interpolation::CatmullRom).unwrap();
        for i in 0..=70 {
            let t = f64::from(i) / 10.0;
            assert!((curve.at(t) - t).abs() < 1e-12);
        }
    }

    #[test]
    fn rotations_take_the_shortest_arc_at_constant_speed() {
        let (a, b) = (DQuat::IDENTITY, -DQuat::from_rotation_y(2.0));
        let curve = Curve::new(vec![0.0, 4.0], vec![a, b], Interpolation::Linear).unwrap();
        for (t, angle) in [(0.0, 0.0), (1.0, 0.5), (2.0, 1.0), (3.0, 1.5), (4.0, 2.0)] {
            let expected = DQuat::from_rotation_y(angle) * DVec3::X;
            assert!((curve.at(t) * DVec3::X - expected).length() < 1e-12);
        }
    }

    #[test]
    fn catmull_rom_rotations_stay_unit_and_pass_their_keys() {
        let keys = [0.0, 1.0, 3.0].map(DQuat::from_rotation_x).to_vec();
        let curve = Curve::new(vec![0.0, 1.0, 2.0], keys, Interpolation::CatmullRom).unwrap();
        for i in 0..=20 {
            assert!((curve.at(f64::from(i) / 10.0).length() - 1.0).abs() < 1e-12);
        }
        assert!((curve.at(1.0) * DVec3::Y - DQuat::from_rotation_x(1.0) * DVec3::Y).length() < 1e-12);
    }

    #[test]
    fn a_curve_without_change_is_constant() {
        let flat = |i| Curve::new(vec![0.0, 1.0, 2.0], vec![5.0; 3], i).unwrap().is_constant();
        assert!(flat(Interpolation::Step) && flat(Interpolation::Linear) && flat(Interpolation::CatmullRom));
        let bulge = Curve::hermite(vec![0.0, 1.0], vec![0.0, 0.0], vec![(1.0, 1.0), (0.0, 0.0)]).unwrap();
        assert!(!bulge.is_constant());
    }
}
