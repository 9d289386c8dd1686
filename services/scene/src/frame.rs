//! The world at one instant.

use crate::{Camera, Material, Texture};
use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;

/// One frame in world space: everything that the preview and the tracer read.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Frame number.
    pub number: u32,
    /// The camera at this instant.
    pub camera: Camera,
    /// All triangles, in world space. Frames in which nothing moves share them.
    pub geometry: Arc<Geometry>,
    /// Materials by index, at this instant. An animated area light changes its material's emission.
    pub materials: Arc<[Material]>,
    /// Textures by [`crate::TextureId`].
    pub textures: Arc<[Texture]>,
    /// Point and spot lights. Area lights are triangles with an emissive material.
    pub points: Vec<PointLight>,
    /// Distant lights.
    pub suns: Vec<Sun>,
    /// Radiance that a ray receives when it leaves the scene.
    pub environment: Environment,
}

impl Frame {
    /// Whether each light emits at this instant: materials by index, points, suns, environment. A material
    /// emits only if it has emission and a triangle in this frame.
    pub fn shining(&self) -> Vec<bool> {
        let mut present = vec![false; self.geometry.strata.pairs.len()];
        self.geometry.triangle_stratum.iter().for_each(|&stratum| present[stratum as usize] = true);
        let mut made_of = vec![false; self.materials.len()];
        for (&(_, material), _) in
            self.geometry.strata.pairs.iter().zip(&present).filter(|(_, present)| **present)
        {
            made_of[material as usize] = true;
        }
        let materials =
            self.materials.iter().zip(made_of).map(|(material, any)| any && material.is_emissive());
        let points = self.points.iter().map(|point| point.intensity.max_element() > 0.0);
        let suns = self.suns.iter().map(|sun| sun.irradiance.max_element() > 0.0);
        let environment = match &self.environment {
            Environment::Black => false,
            Environment::Constant(radiance) => radiance.max_element() > 0.0,
            Environment::Image { scale, .. } => *scale > 0.0,
        };
        materials.chain(points).chain(suns).chain([environment]).collect()
    }
}

/// Indexed triangles with their objects and materials.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// Vertex positions, metres, finite.
    #[serde(with = "crate::bulk")]
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one per vertex. `Vec3::ZERO` means: use the geometric normal.
    #[serde(with = "crate::bulk")]
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one per vertex.
    #[serde(with = "crate::bulk")]
    pub uvs: Vec<Vec2>,
    /// Vertex indices, counter-clockwise seen from the front. The loader has removed triangles of zero area.
    #[serde(with = "crate::bulk")]
    pub triangles: Vec<[u32; 3]>,
    /// Stratum of each triangle: index into `strata`.
    #[serde(with = "crate::bulk")]
    pub triangle_stratum: Vec<u32>,
    /// The (object, material) pairs of the scene. They are the same for every frame of a shot.
    pub strata: Strata,
}

/// The table of strata, (object, material) pairs. The index is the id in every preview and forecast.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Strata {
    /// Object names by object id.
    pub objects: Vec<String>,
    /// (object id, material index) of each stratum.
    pub pairs: Vec<(u32, u32)>,
}

impl Strata {
    /// Number of (object, material) pairs.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Number of materials in use. Material libraries may define more.
    pub fn materials(&self) -> usize {
        self.pairs.iter().map(|&(_, material)| material).collect::<BTreeSet<u32>>().len()
    }

    /// Returns `true` if the scene has no objects.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }
}

impl Geometry {
    /// An attribute's values at the three corners of a triangle. `of_vertices` holds one value per vertex.
    #[inline]
    pub fn at_corners<T: Copy>(&self, triangle: u32, of_vertices: &[T]) -> [T; 3] {
        let [a, b, c] = self.triangles[triangle as usize];
        [of_vertices[a as usize], of_vertices[b as usize], of_vertices[c as usize]]
    }

    /// Positions of the three corners of a triangle, metres.
    #[inline]
    pub fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.at_corners(triangle, &self.positions)
    }

    /// Object id of a triangle.
    #[inline]
    pub fn object(&self, triangle: u32) -> u32 {
        self.strata.pairs[self.triangle_stratum[triangle as usize] as usize].0
    }

    /// Material index of a triangle.
    #[inline]
    pub fn material(&self, triangle: u32) -> u32 {
        self.strata.pairs[self.triangle_stratum[triangle as usize] as usize].1
    }

    /// Unit geometric normal. It points to the side from which the triangle is counter-clockwise.
    #[inline]
    pub fn geometric_normal(&self, triangle: u32) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3()
    }

    /// Texture coordinates at barycentrics (u, v), the weights of the second and third corner.
    #[inline]
    pub fn uv(&self, triangle: u32, u: f32, v: f32) -> Vec2 {
        let [a, b, c] = self.at_corners(triangle, &self.uvs);
        a * (1.0 - u - v) + b * u + c * v
    }
}

/// A point light, with an optional cone (glTF spot light).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointLight {
    /// Position, metres.
    pub position: Vec3,
    /// Radiant intensity, W/sr per channel.
    pub intensity: Vec3,
    /// Unit axis, and cosines of the inner and outer cone angle, of a spot light.
    pub cone: Option<(Vec3, f32, f32)>,
}

/// A distant light of small angular size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sun {
    /// Unit vector towards the sun's centre.
    pub direction: Vec3,
    /// Irradiance on a surface that faces it, W/m² per channel.
    pub irradiance: Vec3,
    /// Angular diameter in degrees. 0 is a delta light with hard shadows.
    pub angle_deg: f32,
}

/// The surroundings of the scene.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub enum Environment {
    /// No light.
    #[default]
    Black,
    /// The same radiance from every direction.
    Constant(Vec3),
    /// A latitude-longitude image, with y up.
    Image {
        /// The image, in linear colour.
        texture: crate::TextureId,
        /// Multiplier of the image's radiance.
        scale: f32,
        /// Rotation about +y, degrees, counter-clockwise seen from above.
        rotation_deg: f32,
    },
}
