//! Sites where irradiance is needed, and the error of using a record at another site.

use super::Planned;
use crate::cache::hemisphere;
use crate::geometry::Basis;
use glam::Vec3;

/// A point on a surface, seen from the side that its normal points to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Position, metres.
    pub position: Vec3,
    /// Largest coordinate of the triangle's corners, metres. It bounds the rounding error of the position.
    pub size: f32,
    /// Unit normal of the gathered hemisphere: the shading normal on the viewer's side.
    pub normal: Vec3,
    /// Unit geometric normal. It may point to either side.
    pub geometric: Vec3,
    /// Index of refraction of the coat; 0 without a coat. A record is only used under the same coat.
    pub coat: f32,
}

/// Two points of one surface are nearly in a plane perpendicular to their mean normal. This is the largest
/// sine of the angle to that plane.
const SLANT: f32 = 0.25;

impl Planned {
    /// The error of using this record at a site: the split-sphere bound without its constants, |p − pᵢ| / Rᵢ
    /// + √(1 − n·nᵢ) (Ward, Rubinstein and Clear 1988, equation 5).
    ///
    /// Returns `None` if the error is not below `allowed`, or if the record must not be used. It must not be
    /// used if it has another coat, faces away, is in front of or behind the surface, or beyond an obstacle.
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

    /// Distance from the record, in a direction, to the nearest obstacle on the surface.
    fn free_distance(&self, towards: Vec3) -> f32 {
        let local = Basis::new(self.site.normal).to_local(towards);
        self.corral[hemisphere::sector(local.x, local.y)]
    }
}

#[cfg(test)]
impl Site {
    /// A site on a flat surface without a coat.
    pub fn bare(position: Vec3, normal: Vec3) -> Self {
        Self { position, size: 1.0, normal, geometric: normal, coat: 0.0 }
    }
}

#[cfg(test)]
impl Planned {
    /// A record whose rays hit nothing. The radius is in metres.
    pub fn in_the_open(site: Site, radius: f32) -> Self {
        let hits = Box::new([None; hemisphere::PLAN_RAYS]);
        Self { key: 0, site, radius, corral: [f32::INFINITY; hemisphere::SECTORS], hits }
    }
}
