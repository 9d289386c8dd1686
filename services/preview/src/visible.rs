//! Rules that GPU and CPU previews share: what is drawn, the near distance, and the point that a pixel shows.

use crate::error::PreviewError;
use crate::preview::{NOTHING, Preview};
use crate::{clock::ThreadClock, cost::Cost};
use forelight_scene::{Camera, Frame, Geometry, Texels, TextureId};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Largest number of pixels of an image. A preview holds 28 bytes per pixel.
const MOST_PIXELS: u64 = 1 << 28;

/// Surfaces with a constant opacity below this are not drawn.
const OPAQUE_ENOUGH: f32 = 0.5;

/// Near distance relative to the size of the scene. Closer points coincide with the eye in f32.
const NEAR: f32 = 1e-7;

/// Checks that the camera has an image, and a finite direction for every pixel.
pub(crate) fn check(camera: &Camera) -> Result<(), PreviewError> {
    let Camera { width, height, .. } = *camera;
    if width == 0 || height == 0 {
        return Err(PreviewError::EmptyImage { width, height });
    }
    if u64::from(width) * u64::from(height) > MOST_PIXELS {
        return Err(PreviewError::ImageTooLarge { width, height, limit: MOST_PIXELS });
    }
    let vectors = [
        ("origin", camera.origin),
        ("right", camera.right),
        ("up", camera.up),
        ("forward", camera.forward),
        ("field of view", Vec3::new(camera.tan_half_x, camera.tan_half_y, 0.0)),
    ];
    for (name, vector) in vectors {
        if !vector.is_finite() {
            return Err(PreviewError::Camera(name));
        }
    }
    if camera.tan_half_x <= 0.0 || camera.tan_half_y <= 0.0 {
        return Err(PreviewError::Camera("field of view"));
    }
    Ok(())
}

/// Distance along the view direction, in metres, from which on surfaces are visible: 10⁻⁷ of the vertices'
/// bounding-box diagonal. Always positive.
pub(crate) fn near_distance(geometry: &Geometry) -> f32 {
    let mut lower = Vec3::INFINITY;
    let mut upper = Vec3::NEG_INFINITY;
    for &p in &geometry.positions {
        lower = lower.min(p);
        upper = upper.max(p);
    }
    let diagonal = (upper - lower).length();
    if diagonal.is_finite() { (diagonal * NEAR).max(f32::MIN_POSITIVE / NEAR) } else { NEAR }
}

/// Whether a stratum's surface is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Drawn {
    Always,
    Never,
    /// Where the texture's alpha is at least the cutoff.
    Where {
        texture: TextureId,
        cutoff: f32,
    },
}

/// What is drawn of each stratum.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cutouts {
    pub by_stratum: Vec<Drawn>,
    /// Whether any stratum is drawn only partly or not at all.
    pub any: bool,
}

impl Cutouts {
    pub fn of(frame: &Frame) -> Self {
        let drawn = |&(_, material): &(u32, u32)| {
            let material = &frame.materials[material as usize];
            match material.mask {
                _ if material.opacity < OPAQUE_ENOUGH => Drawn::Never,
                None => Drawn::Always,
                Some(mask) => match frame.textures[mask.texture.0 as usize].texels {
                    Texels::Srgb8(_) => Drawn::Where { texture: mask.texture, cutoff: mask.cutoff },
                    // An image without an alpha channel is opaque everywhere.
                    Texels::Linear(_) if mask.cutoff > 1.0 => Drawn::Never,
                    Texels::Linear(_) => Drawn::Always,
                },
            }
        };
        let by_stratum: Vec<Drawn> = frame.geometry.strata.pairs.iter().map(drawn).collect();
        let any = by_stratum.iter().any(|d| *d != Drawn::Always);
        Self { by_stratum, any }
    }

    /// Whether the point (u, v) of a triangle is drawn.
    pub fn keeps(&self, frame: &Frame, triangle: u32, u: f32, v: f32) -> bool {
        match self.by_stratum[frame.geometry.triangle_stratum[triangle as usize] as usize] {
            Drawn::Always => true,
            Drawn::Never => false,
            Drawn::Where { texture, cutoff } => {
                frame.textures[texture.0 as usize].alpha(frame.geometry.uv(triangle, u, v)) >= cutoff
            }
        }
    }
}

/// Centre of a pixel, in pixels from the top-left corner of the image.
pub(crate) fn centre(x: u32, y: u32) -> Vec2 {
    Vec2::new(x as f32 + 0.5, y as f32 + 0.5)
}

/// The point where the camera ray meets the triangle, by Cramer's rule in f64. If the ray misses it or sees
/// it edge-on, as a rasteriser allows, the nearest point of the triangle in barycentric coordinates.
fn point_on(corners: [Vec3; 3], camera: &Camera, direction: Vec3) -> Vec3 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let (edge_b, edge_c) = (b - a, c - a);
    let direction = direction.as_dvec3();
    let from_a = camera.origin.as_dvec3() - a;
    let determinant = direction.dot(edge_b.cross(edge_c));
    let turned = direction.cross(from_a);
    let u = edge_c.dot(turned) / determinant;
    let v = -edge_b.dot(turned) / determinant;
    let (mut u, mut v) = if u.is_finite() && v.is_finite() { (u.max(0.0), v.max(0.0)) } else { (1.0, 1.0) };
    let sum = u + v;
    if sum > 1.0 {
        (u, v) = (u / sum, v / sum);
    }
    (a + u * edge_b + v * edge_c).as_vec3()
}

/// Computes a preview from the triangle of each pixel, [`NOTHING`] for none. Adds the CPU time to `cost`.
pub(crate) fn resolve(frame: &Frame, triangles: &[u32], cost: &mut Cost) -> Preview {
    let Camera { width, height, .. } = frame.camera;
    let geometry = &*frame.geometry;
    let pixels = frame.camera.pixels();
    let mut preview = Preview {
        width,
        height,
        stratum: vec![NOTHING; pixels],
        position: vec![Vec3::ZERO; pixels],
        normal: vec![Vec3::ZERO; pixels],
        pairs: geometry.strata.pairs.as_slice().into(),
    };
    let row = width as usize;
    let rows = triangles
        .par_chunks(row)
        .zip(preview.stratum.par_chunks_mut(row))
        .zip(preview.position.par_chunks_mut(row))
        .zip(preview.normal.par_chunks_mut(row));
    cost.cpu_nanos += rows
        .enumerate()
        .map(|(y, (((triangles, strata), positions), normals))| {
            let clock = ThreadClock::start();
            // Neighbouring pixels mostly show the same triangle, so its normal is kept.
            let mut last = (NOTHING, Vec3::ZERO);
            for (x, &triangle) in triangles.iter().enumerate() {
                if triangle == NOTHING {
                    continue;
                }
                if last.0 != triangle {
                    last = (triangle, geometry.geometric_normal(triangle));
                }
                let direction = frame.camera.direction(centre(x as u32, y as u32));
                strata[x] = geometry.triangle_stratum[triangle as usize];
                positions[x] = point_on(geometry.corners(triangle), &frame.camera, direction);
                normals[x] = last.1;
            }
            clock.nanos()
        })
        .sum::<u64>();
    preview
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera {
            origin: Vec3::new(1.0, 2.0, 3.0),
            right: Vec3::X,
            up: Vec3::Y,
            forward: Vec3::NEG_Z,
            tan_half_x: 1.0,
            tan_half_y: 1.0,
            width: 4,
            height: 4,
            aperture_radius: 0.0,
            focus_distance: 1.0,
        }
    }

    #[test]
    fn a_point_lies_on_the_ray_and_on_the_triangle() {
        let corners = [Vec3::new(-9.0, -7.0, -2.0), Vec3::new(20.0, -6.0, 1.0), Vec3::new(2.0, 30.0, -5.0)];
        let camera = camera();
        let direction = Vec3::new(0.1, -0.2, -1.0);
        let p = point_on(corners, &camera, direction);
        let along = p - camera.origin;
        assert!((along / along.dot(camera.forward) - direction).length() < 1e-6);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        assert!(normal.dot(p - corners[0]).abs() < 1e-5);
    }

    #[test]
    fn a_missed_or_edge_on_triangle_still_gives_a_point_of_its_own() {
        let edge_on = [Vec3::new(1.0, 0.0, 0.0), Vec3::new(1.0, 4.0, 0.0), Vec3::new(1.0, 2.0, -4.0)];
        let missed = [Vec3::new(2.0, 2.0, 0.0), Vec3::new(3.0, 2.0, 0.0), Vec3::new(2.0, 3.0, 0.0)];
        for corners in [edge_on, missed] {
            let p = point_on(corners, &camera(), Vec3::NEG_Z);
            let [a, b, c] = corners;
            assert!(p.is_finite());
            assert!(p.cmpge(a.min(b).min(c) - 1e-6).all() && p.cmple(a.max(b).max(c) + 1e-6).all(), "{p}");
        }
    }

    #[test]
    fn the_near_distance_is_positive_for_any_scene() {
        assert!(near_distance(&Geometry::default()) > 0.0);
        let point = Geometry { positions: vec![Vec3::ONE], ..Geometry::default() };
        assert!(near_distance(&point) > 0.0);
        let room = Geometry { positions: vec![Vec3::ZERO, Vec3::new(3.0, 4.0, 0.0)], ..Geometry::default() };
        assert!((near_distance(&room) - 5e-7).abs() < 1e-12);
    }
}
