//! The renderer's side of the door: what Cycles is, what it can, and how a scene is opened.

use crate::installation::Cycles;
use crate::settings::SCHEMA;
use crate::shot::BlenderShot;
use forelight_renderer::door::{Capabilities, Capability, Renderer, RendererError, RendererId, Run, Shot};
use serde_json::Value;
use std::path::Path;

impl Renderer for Cycles {
    fn id(&self) -> &RendererId {
        &self.id
    }

    fn settings_schema(&self) -> Value {
        SCHEMA.clone()
    }

    fn capabilities(&self) -> Capabilities {
        let mut all = Capabilities::from([
            Capability::MeasureSamples,
            Capability::MeasureRegions,
            Capability::MeasureManyRegions,
            Capability::TakeOverSamples,
        ]);
        if locates_costs(&self.id.version) {
            all.insert(Capability::LocateCosts);
        }
        all
    }

    fn open(&self, scene: &Path, run: &Run<'_>) -> Result<Box<dyn Shot>, RendererError> {
        Ok(Box::new(BlenderShot::open(self.clone(), scene, run)?))
    }
}

/// Whether Cycles writes the time of each pixel: since Blender 5.0.
fn locates_costs(version: &str) -> bool {
    version.split('.').next().and_then(|major| major.parse().ok()).is_some_and(|major: u32| major >= 5)
}

#[cfg(test)]
mod tests {
    use super::locates_costs;

    #[test]
    fn costs_are_located_from_blender_5_on() {
        assert!(locates_costs("5.0.1") && !locates_costs("4.5.15"));
    }
}
