//! Axis-aligned boxes.

use glam::{DVec3, Vec3};

/// An axis-aligned box. It is empty if `low` exceeds `high`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    pub low: Vec3,
    pub high: Vec3,
}

impl Default for Bounds {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Bounds {
    pub const EMPTY: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| Self { low: b.low.min(p), high: b.high.max(p) })
    }

    pub fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// The box, grown by `margin` on every side.
    pub fn grown(self, margin: f32) -> Self {
        self.grown_by(Vec3::splat(margin))
    }

    /// The box, grown by `margin[axis]` on both sides of each axis.
    pub fn grown_by(self, margin: Vec3) -> Self {
        Self { low: self.low - margin, high: self.high + margin }
    }

    /// Half the lengths of its edges.
    pub fn half(&self) -> Vec3 {
        (self.high - self.low) * 0.5
    }

    pub fn contains(&self, point: Vec3) -> bool {
        point.cmpge(self.low).all() && point.cmple(self.high).all()
    }

    pub fn overlaps(&self, other: &Self) -> bool {
        self.low.cmple(other.high).all() && other.low.cmple(self.high).all()
    }

    pub fn holds(&self, other: &Self) -> bool {
        self.low.cmple(other.low).all() && other.high.cmple(self.high).all()
    }

    /// Largest absolute coordinate.
    pub fn reach(&self) -> f32 {
        self.low.abs().max(self.high.abs()).max_element()
    }

    pub fn corners(&self) -> impl Iterator<Item = Vec3> {
        let ends = [self.low, self.high];
        (0..8).map(move |i| Vec3::new(ends[i & 1].x, ends[i >> 1 & 1].y, ends[i >> 2].z))
    }

    /// Whether the half-line `origin` + t · `direction`, t ≥ 0, may meet the box. `inverse` = 1 / `direction`
    /// is finite.
    pub fn is_ahead(&self, origin: DVec3, inverse: DVec3) -> bool {
        let (a, b) = ((self.low.as_dvec3() - origin) * inverse, (self.high.as_dvec3() - origin) * inverse);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        // Much larger than rounding in f64: reporting in vain costs one test, missing a box is wrong.
        let slack = 1e-9 * (near.abs() + far.abs());
        far >= -slack && near <= far + slack
    }

    /// Returns `true` if the segment origin + t · direction, 0 ≤ t ≤ length, touches the box.
    pub fn meets(&self, origin: Vec3, direction: Vec3, length: f32) -> bool {
        let (mut near, mut far) = (0.0f32, length);
        for axis in 0..3 {
            let (low, high) = (self.low[axis] - origin[axis], self.high[axis] - origin[axis]);
            if direction[axis] == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return false;
                }
                continue;
            }
            let (a, b) = (low / direction[axis], high / direction[axis]);
            (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
        }
        near <= far
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_knows_what_lies_ahead() {
        let cube = Bounds { low: Vec3::ZERO, high: Vec3::ONE };
        let inverse = DVec3::new(0.01, 0.02, 1.0).recip();
        assert!(cube.is_ahead(DVec3::new(0.5, 0.5, -3.0), inverse));
        assert!(cube.is_ahead(DVec3::splat(0.5), inverse));
        assert!(!cube.is_ahead(DVec3::new(0.5, 0.5, 2.0), inverse));
        assert!(!cube.is_ahead(DVec3::new(0.5, 1.5, 0.5), inverse));
    }
}
