//! A scene that was opened: what all questions about it share.

use crate::ids::{Kept, Names};
use crate::installation::Radiance;
use crate::scene::Scene;

/// A scene of Radiance, and what previews found out about it.
pub(crate) struct Opened {
    pub radiance: Radiance,
    pub scene: Scene,
    pub names: Names,
    pub kept: Kept,
}

impl Opened {
    pub fn new(radiance: Radiance, scene: Scene) -> Self {
        Self { radiance, scene, names: Names::default(), kept: Kept::default() }
    }

    /// Arguments of rtrace: those of the settings, and those of the scene that no setting stands for.
    pub fn arguments(&self, of_settings: Vec<String>) -> Vec<String> {
        of_settings.into_iter().chain(self.scene.arguments.kept.iter().cloned()).collect()
    }
}
