//! Bounds of a set of lights: position, directions, and how much light it can bring to a point.

use crate::bounds::Bounds as Place;
use glam::{DVec3, Vec3};
use std::f64::consts::{FRAC_PI_2, PI};

/// The point that is lit.
#[derive(Debug, Clone, Copy)]
pub struct Receiver {
    pub position: Vec3,
    /// Light from below the plane of this normal does not count. `None`: all light counts.
    pub normal: Option<Vec3>,
}

/// Bounds of one or more lights. The axis of every light is within the angle `spread` of `axis`, and every
/// light emits up to the angle `reach` from its own axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    pub low: Vec3,
    pub high: Vec3,
    axis: Vec3,
    /// Cosine and sine of the spread.
    spread: (f32, f32),
    /// Cosine of the reach.
    reach: f32,
    /// Whether the lights emit in the opposite directions too.
    both_sides: bool,
    /// Sum of the lights' radiant intensities along their axes, in the strongest channel, W/sr.
    pub intensity: f64,
    /// The largest area of a light, m².
    pub largest_area: f32,
}

/// Tolerance on cosines. The bounds are wider by more than the rounding errors in f32.
const SLACK: f32 = 1e-3;

impl Bounds {
    /// A flat light with cosine falloff. It emits from the side that `normal` points to, or from both sides.
    pub fn flat(place: Place, normal: Vec3, area: f32, both_sides: bool, intensity: f64) -> Self {
        Self {
            low: place.low,
            high: place.high,
            axis: normal,
            spread: (1.0, 0.0),
            reach: 0.0,
            both_sides,
            intensity,
            largest_area: area,
        }
    }

    /// A point light with constant intensity in all directions, or in a cone with the given axis and cosine.
    pub fn point(position: Vec3, cone: Option<(Vec3, f32)>, intensity: f64) -> Self {
        let (axis, cos) = cone.unwrap_or((Vec3::Z, -1.0));
        let cos = cos.clamp(-1.0, 1.0);
        Self {
            low: position,
            high: position,
            axis,
            spread: (cos, ((1.0 - cos) * (1.0 + cos)).sqrt()),
            reach: 1.0,
            both_sides: false,
            intensity,
            largest_area: 0.0,
        }
    }

    /// The bounding box of the lights.
    pub fn place(&self) -> Place {
        Place { low: self.low, high: self.high }
    }

    /// Centre of the box.
    pub fn centre(&self) -> Vec3 {
        0.5 * self.low + 0.5 * self.high
    }

    /// Bounds of the lights of both.
    pub fn union(&self, other: &Self) -> Self {
        let (axis, spread) = self.cone_with(other);
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            axis,
            spread,
            reach: self.reach.min(other.reach),
            both_sides: self.both_sides || other.both_sides,
            intensity: self.intensity + other.intensity,
            largest_area: self.largest_area.max(other.largest_area),
        }
    }

    /// Smallest cone around the axes of both (Conty Estevez and Kulla 2018, algorithm 1), slightly widened.
    fn cone_with(&self, other: &Self) -> (Vec3, (f32, f32)) {
        let angle = |b: &Self| libm::atan2(b.spread.1.into(), b.spread.0.into());
        let (wide, narrow) = if angle(self) >= angle(other) { (self, other) } else { (other, self) };
        let (a, b) = (wide.axis.as_dvec3(), narrow.axis.as_dvec3());
        let between = libm::atan2(a.cross(b).length(), a.dot(b));
        let (wide_angle, narrow_angle) = (angle(wide), angle(narrow));
        if (between + narrow_angle).min(PI) <= wide_angle {
            return (wide.axis, wide.spread);
        }
        let spread = 0.5 * (wide_angle + between + narrow_angle) + 1e-6;
        let full = (wide.axis, (-1.0, 0.0));
        let across = (b - a.dot(b) * a).normalize_or_zero();
        if spread >= PI || across == DVec3::ZERO {
            return full; // opposite axes have no plane in which to rotate one towards the other
        }
        let turn = spread - wide_angle;
        let axis = libm::cos(turn) * a + libm::sin(turn) * across;
        (axis.normalize().as_vec3(), (libm::cos(spread) as f32, libm::sin(spread) as f32))
    }

    /// Importance of the lights at a receiver: an estimate of the light that they bring (Conty Estevez and
    /// Kulla 2018, equation 3). It is zero only if none can reach the receiver.
    ///
    /// The cosines are bounded by the box, not by its bounding sphere, because a flat box of lights, such as
    /// a ceiling, shows that angles are grazing.
    pub fn importance(&self, receiver: &Receiver) -> f64 {
        let (centre, half) = (self.centre(), 0.5 * self.high - 0.5 * self.low);
        let to = receiver.position - centre;
        // Within the bounding sphere, the distance is about the size of the box.
        let attenuation = to.length_squared().max(half.length_squared()).max(f32::MIN_POSITIVE);
        // Bound of the rounding errors of the differences.
        let rounding = 4.0 * f32::EPSILON * receiver.position.abs().max(centre.abs()).max_element();
        let nearest = (to.abs() - half).max(Vec3::ZERO).length() - rounding;
        // Upper bound of the cosine between an axis and the directions from the box to the receiver.
        let bound = |axis: Vec3, along: f32| {
            let most = along + axis.abs().dot(half) + rounding;
            match most > 0.0 {
                true if most >= nearest => 1.0,
                true => most / nearest,
                false => most / ((to.abs() + half).length() + rounding),
            }
        };
        let along = self.axis.dot(to);
        let cos = bound(self.axis, if self.both_sides { along.abs() } else { along });
        let emitted = cos_less(cos, self.spread);
        if emitted < self.reach - SLACK {
            return 0.0;
        }
        let received = receiver.normal.map_or(1.0, |normal| bound(normal, -normal.dot(to)));
        if received < -SLACK {
            return 0.0;
        }
        self.intensity * f64::from(emitted.max(SLACK) * received.max(SLACK)) / f64::from(attenuation)
    }
}

/// Cosine of max(0, α − β), from cos α with α in [0, π], and cosine and sine of β.
fn cos_less(cos: f32, other: (f32, f32)) -> f32 {
    if cos >= other.0 {
        return 1.0;
    }
    let sin = ((1.0 - cos) * (1.0 + cos)).max(0.0).sqrt();
    cos * other.0 + sin * other.1
}

/// Summary of a set of lights. It is quick to merge and sufficient to compare splits of the set.
#[derive(Debug, Clone, Copy)]
pub struct Shine {
    low: Vec3,
    high: Vec3,
    axes: DVec3,
    count: f64,
    widest: f32,
    reach: f32,
    intensity: f64,
}

impl Shine {
    pub const NONE: Self = Self {
        low: Vec3::INFINITY,
        high: Vec3::NEG_INFINITY,
        axes: DVec3::ZERO,
        count: 0.0,
        widest: 1.0,
        reach: 1.0,
        intensity: 0.0,
    };

    pub fn is_none(&self) -> bool {
        self.count == 0.0
    }

    pub fn add(&mut self, light: &Bounds) {
        self.merge(&Self {
            low: light.low,
            high: light.high,
            axes: if light.both_sides { DVec3::ZERO } else { light.axis.as_dvec3() },
            count: 1.0,
            widest: light.spread.0,
            reach: light.reach,
            intensity: light.intensity,
        });
    }

    pub fn merge(&mut self, other: &Self) {
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
        self.axes += other.axes;
        self.count += other.count;
        self.widest = self.widest.min(other.widest);
        self.reach = self.reach.min(other.reach);
        self.intensity += other.intensity;
    }

    /// Expected cost of choosing among these lights: intensity × size × the solid angle that they emit into
    /// (Conty Estevez and Kulla 2018, equations 1 and 2). The size is the squared diagonal, which is not zero
    /// for lights in a row.
    pub fn cost(&self) -> f64 {
        if self.is_none() {
            return 0.0;
        }
        let size = (self.high - self.low).as_dvec3().length_squared().max(f64::MIN_POSITIVE);
        let mean = self.axes.length() / self.count;
        let spread = libm::acos((2.0 * mean - 1.0).clamp(-1.0, 1.0).min(self.widest.into()));
        let reach = libm::acos(f64::from(self.reach).clamp(-1.0, 1.0));
        self.intensity * size * solid_angle(spread, reach)
    }
}

/// Solid angle of a cone with half-angle `spread`, plus the cosine-weighted one beyond up to `reach`.
fn solid_angle(spread: f64, reach: f64) -> f64 {
    let (sin, cos) = (libm::sin(spread), libm::cos(spread));
    let end = (spread + reach).min(PI);
    2.0 * PI * (1.0 - cos)
        + FRAC_PI_2 * (2.0 * end * sin - libm::cos(spread - 2.0 * end) - 2.0 * spread * sin + cos)
}
