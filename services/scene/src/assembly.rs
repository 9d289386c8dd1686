//! A scene under construction, filled by the readers of geometry files.

use crate::bundle::Bundle;
use crate::camera_source::NodeCamera;
use crate::error::SceneError;
use crate::images::TextureLibrary;
use crate::shot::Shot;
use crate::{Color, MOST_NESTED, Material, Surface};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// A light on a node of a glTF file.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct NodeLight {
    pub(crate) node: usize,
    pub(crate) kind: NodeLightKind,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum NodeLightKind {
    /// Radiant intensity in W/sr. `cone` holds the cosines of the inner and outer cone angle.
    Point { intensity: Vec3, cone: Option<(f32, f32)> },
    /// Irradiance in W/m².
    Directional { irradiance: Vec3 },
}

/// A scene under construction.
pub(crate) struct Assembly<'a> {
    pub(crate) bundle: &'a Bundle,
    /// Frames per second. It converts glTF times to frames.
    pub(crate) fps: f64,
    pub(crate) shot: Shot,
    pub(crate) materials: Vec<Material>,
    pub(crate) textures: TextureLibrary<'a>,
    pub(crate) lights: Vec<NodeLight>,
    pub(crate) cameras: Vec<NodeCamera>,
    /// First and last key of the animations in geometry files, in frames.
    pub(crate) keys: Option<(f64, f64)>,
    pub(crate) warnings: Vec<String>,
}

impl<'a> Assembly<'a> {
    pub(crate) fn new(bundle: &'a Bundle, fps: f64) -> Self {
        Self {
            bundle,
            fps,
            shot: Shot::default(),
            materials: Vec::new(),
            textures: TextureLibrary::new(bundle),
            lights: Vec::new(),
            cameras: Vec::new(),
            keys: None,
            warnings: Vec::new(),
        }
    }

    /// Logs and keeps a warning.
    pub(crate) fn warn(&mut self, warning: String) {
        tracing::warn!("{warning}");
        self.warnings.push(warning);
    }

    /// Adds a material and returns its index.
    pub(crate) fn add_material(&mut self, material: Material) -> u32 {
        self.materials.push(material);
        self.materials.len() as u32 - 1
    }

    /// Checks the number of materials with a priority against [`MOST_NESTED`], after each added material.
    pub(crate) fn check_priorities(&self, file: &str) -> Result<(), SceneError> {
        let is_nested = |material: &&Material| material.surface.priority().is_some();
        // Count only if the last material has a priority, because a file may hold very many materials.
        if self.materials.last().filter(is_nested).is_none() {
            return Ok(());
        }
        let (found, limit) = (self.materials.iter().filter(is_nested).count() as u64, MOST_NESTED as u64);
        if found > limit {
            let what = "materials with a priority";
            return Err(SceneError::Limit { file: file.to_owned(), what, found, limit });
        }
        Ok(())
    }

    /// Checks the scene's size so far, plus `triangles` and `vertices`, against the limits.
    pub(crate) fn check_size(&self, file: &str, triangles: u64, vertices: u64) -> Result<(), SceneError> {
        let limit = self.bundle.limits().triangles;
        let found = self.shot.triangle_count() + triangles;
        if found > limit {
            return Err(SceneError::Limit { file: file.to_owned(), what: "triangles", found, limit });
        }
        // Unused vertices cost memory too. All vertex indices must fit in 32 bits.
        let (found, limit) =
            (self.shot.vertex_count() + vertices, limit.saturating_mul(3).min(u64::from(u32::MAX)));
        if found > limit {
            return Err(SceneError::Limit { file: file.to_owned(), what: "vertices", found, limit });
        }
        Ok(())
    }
}

/// An opaque material without emission.
pub(crate) fn plain_material(name: &str, surface: Surface) -> Material {
    Material {
        name: name.to_owned(),
        surface,
        emission: Color::plain(Vec3::ZERO),
        emits_both_sides: false,
        opacity: 1.0,
        mask: None,
    }
}
