//! Records of the irradiance cache: planned, gathered and smoothed.

use super::hemisphere::{Irradiance, PLAN_RAYS, SECTORS, Strata, sector};
use super::site::Site;
use crate::cost::Cost;
use crate::geometry::Basis;
use crate::random::Sampler;
use forelight_bvh::Hit;
use glam::Vec3;

/// A planned record.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Random key of its gather.
    pub key: u64,
    /// Its position and orientation.
    pub site: Site,
    /// Radius of validity before it is scaled by the allowed error, metres.
    pub radius: f32,
    /// Distance along the surface to the nearest obstacle, for each sector of azimuth, metres.
    pub corral: [f32; SECTORS],
    /// Hits of the plan's rays. They are boxed, because reading accesses the other fields millions of times.
    pub hits: Box<[Option<Hit>; PLAN_RAYS]>,
    /// Radiance that each of them brings to the record without further bounces, mean over the channels, at most
    /// [`Planned::BRIGHTEST`]. 0 from a secondary light.
    pub lit: Box<[f32; PLAN_RAYS]>,
}

/// Two points of one surface lie nearly perpendicular to their mean normal: largest sine of that angle.
const SLANT: f32 = 0.25;

impl Planned {
    /// The guide needs no larger radiances, and squares them.
    pub const BRIGHTEST: f32 = 1e12;

    /// The error of using this record at a site: |p − pᵢ| / Rᵢ + √(1 − n·nᵢ), the split-sphere bound without
    /// its constants (Ward, Rubinstein and Clear 1988, equation 5). `None` if it is not below `allowed`, or
    /// the record has another coat, faces away, is in front of or behind the surface, or beyond an obstacle.
    pub fn error(&self, place: &Site, allowed: f32) -> Option<f32> {
        let difference = place.position - self.site.position;
        let distance2 = difference.length_squared();
        let farthest = allowed * self.radius;
        let cos = self.site.normal.dot(place.normal);
        // Check the distance first, because most of the records considered are too far away.
        if !(distance2 < farthest * farthest && cos > 0.0 && self.site.coat == place.coat) {
            return None;
        }
        let distance = distance2.sqrt();
        let error = distance / self.radius + (1.0 - cos).max(0.0).sqrt();
        let mean_normal = self.site.normal + place.normal;
        let slant = 0.5 * difference.dot(mean_normal).abs();
        let fits = error < allowed && slant <= SLANT * distance;
        (fits && distance <= self.free_distance(difference)).then_some(error)
    }

    /// World directions of the plan's rays. `strata` are those of its level.
    pub fn directions(&self, strata: &Strata) -> impl Iterator<Item = Vec3> + use<> {
        let (basis, sampler, strata) = (Basis::new(self.site.normal), Sampler::keyed(self.key), *strata);
        (0..PLAN_RAYS).map(move |ray| basis.to_world(strata.direction(strata.of_plan(ray), 0, &sampler)))
    }

    /// Distance from the record, in a direction, to the nearest obstacle on the surface.
    fn free_distance(&self, towards: Vec3) -> f32 {
        let local = Basis::new(self.site.normal).to_local(towards);
        self.corral[sector(local.x, local.y)]
    }
}

#[cfg(test)]
impl Planned {
    /// A record whose rays hit nothing. The radius is in metres.
    pub fn in_the_open(site: Site, radius: f32) -> Self {
        let hits = Box::new([None; PLAN_RAYS]);
        Self { key: 0, site, radius, corral: [f32::INFINITY; SECTORS], hits, lit: Box::new([0.0; PLAN_RAYS]) }
    }
}

/// The result of a gather at a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Irradiance that reaches the base under the surface's coat, W/m² per channel.
    pub irradiance: Vec3,
    /// Rotational gradient of each channel's irradiance, per radian.
    pub rotation: [Vec3; 3],
    /// Translational gradient of each channel's irradiance, per metre.
    pub translation: [Vec3; 3],
    /// Radius within which the gradients can be trusted, metres. At most the planned radius.
    pub trusted: f32,
    /// Standard error of the irradiance due to the finite number of rays, mean over the channels, W/m².
    pub noise: f32,
    /// Set if a value is not finite. Such a record is never used.
    pub rejected: bool,
    /// Cost of the gather.
    pub cost: Cost,
    /// Rays of the gather, by category.
    pub rays: [u32; 7],
}

impl Record {
    /// The record for a gather, with limited gradients (Křivánek et al. 2006). A gradient that changes the
    /// irradiance by its full value within a distance limits the trusted radius to it. Below the smallest
    /// radius, the gradient is reduced instead.
    pub fn new(planned: &Planned, irradiance: &Irradiance, smallest: f32) -> Self {
        let (value, mut translation) = (irradiance.value, irradiance.translation);
        let mut trusted = planned.radius;
        for channel in 0..3 {
            let slope = translation[channel].length();
            let level_within = if slope > 0.0 { value[channel] / slope } else { f32::INFINITY };
            trusted = trusted.min(level_within.max(smallest));
            if level_within < smallest {
                translation[channel] *= level_within / smallest;
            }
        }
        let mut record = Self {
            rejected: false,
            irradiance: value,
            rotation: irradiance.rotation,
            translation,
            trusted,
            noise: irradiance.noise,
            cost: Cost::default(),
            rays: [0; 7],
        };
        record.rejected = !record.is_finite();
        record
    }

    /// Returns `true` if every value is finite.
    pub fn is_finite(&self) -> bool {
        Value::of(self).is_finite() && self.noise.is_finite()
    }
}

/// The value of a record, as it is read.
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
    /// Set if the record must not be used.
    pub rejected: bool,
}

/// The smoothed values of a level.
#[derive(Debug, Clone, Default)]
pub struct Smoothed {
    pub values: Vec<Value>,
    /// CPU time of smoothing, nanoseconds. Its work is included in the records' work.
    pub cpu_nanos: u64,
    /// Whether all records were filled.
    pub whole: bool,
}

impl Value {
    /// The gathered value.
    pub fn of(record: &Record) -> Self {
        let Record { irradiance, rotation, translation, trusted, noise, rejected, .. } = *record;
        Self { irradiance, rotation, translation, trusted, noise, rejected }
    }

    /// Returns `true` if irradiance and gradients are finite.
    pub fn is_finite(&self) -> bool {
        let mut gradients = self.rotation.iter().chain(&self.translation);
        self.irradiance.is_finite() && gradients.all(|gradient| gradient.is_finite())
    }

    /// Irradiance at another site by the gradients, limited to `LEAST` to `MOST` times the record's.
    /// `difference` is the offset from the record in metres, and `turn` = nᵢ × n the rotation of the normal.
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

/// Cost of gathering and smoothing one record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordCost {
    /// Level of the record, from 0.
    pub level: u32,
    /// Index of the record in its level. Records taken over from another frame come first.
    pub index: usize,
    /// Work and CPU time.
    pub cost: Cost,
    /// Rays by category.
    pub rays: [u32; 7],
}
