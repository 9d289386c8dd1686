//! Where irradiance is wanted, and when one place serves for another.

use super::Planned;
use crate::cache::hemisphere;
use crate::geometry::Basis;
use glam::Vec3;

/// A place on a surface, seen from the side that its normal is on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Position, metres.
    pub position: Vec3,
    /// Largest coordinate of the triangle's corners, on which the position's rounding depends, metres.
    pub size: f32,
    /// Unit normal about which the hemisphere is gathered: the shading normal on the viewer's side.
    pub normal: Vec3,
    /// Unit geometric normal, on either side.
    pub geometric: Vec3,
    /// Index of refraction of the coat through which light arrives; 0 without a coat. Records serve for places under the same
    /// coat only.
    pub coat: f32,
}

/// Two points of one surface lie in a plane across their mean normal, or nearly: at most this sine of the angle to it.
const SLANT: f32 = 0.25;

impl Planned {
    /// The error of using this record at a place, in units in which the allowed error is compared: the split-sphere bound without its
    /// constants, |p − pᵢ| / Rᵢ + √(1 − n·nᵢ) (Ward, Rubinstein, Clear 1988, equation 5). `None` if that is not below `allowed`, and
    /// where the record must not be used at all: on another side, in front of or behind the surface, beyond something that
    /// stands in the way.
    pub fn error(&self, place: &Site, allowed: f32) -> Option<f32> {
        let difference = place.position - self.site.position;
        let distance2 = difference.length_squared();
        let farthest = allowed * self.radius;
        let cos = self.site.normal.dot(place.normal);
        // Most of the records that are looked at are too far off: that is found out first.
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

    /// How far from the record, in a direction, nothing stands on the surface.
    fn free_distance(&self, towards: Vec3) -> f32 {
        let local = Basis::new(self.site.normal).to_local(towards);
        self.corral[hemisphere::sector(local.x, local.y)]
    }
}

#[cfg(test)]
impl Site {
    /// A place on an uncoated, flat surface.
    pub fn bare(position: Vec3, normal: Vec3) -> Self {
        Self { position, size: 1.0, normal, geometric: normal, coat: 0.0 }
    }
}

#[cfg(test)]
impl Planned {
    /// A record whose rays meet nothing, with a radius in metres.
    pub fn in_the_open(site: Site, radius: f32) -> Self {
        let hits = Box::new([None; hemisphere::PLAN_RAYS]);
        Self { key: 0, site, radius, corral: [f32::INFINITY; hemisphere::SECTORS], hits }
    }
}
