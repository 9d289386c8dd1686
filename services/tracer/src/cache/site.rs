//! Sites: points where irradiance is needed.

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

/// A site, with the random key of its gather.
pub type Keyed = (u64, Site);

#[cfg(test)]
impl Site {
    /// A site on a flat surface without a coat.
    pub fn bare(position: Vec3, normal: Vec3) -> Self {
        Self { position, size: 1.0, normal, geometric: normal, coat: 0.0 }
    }
}
