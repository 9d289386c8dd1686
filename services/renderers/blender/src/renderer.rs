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
        ]);
        // What came with which version of Blender.
        let since = [(Capability::TakeOverSamples, (4, 4)), (Capability::LocateCosts, (5, 0))];
        let version = release(&self.id.version);
        all.extend(since.iter().filter(|(_, first)| version >= *first).map(|(capability, _)| *capability));
        all
    }

    fn open(&self, scene: &Path, run: &Run<'_>) -> Result<Box<dyn Shot>, RendererError> {
        Ok(Box::new(BlenderShot::open(self.clone(), scene, run)?))
    }
}

/// First and second number of a version. Zeros if it has none.
fn release(version: &str) -> (u32, u32) {
    let mut numbers = version.split('.').map(|number| number.parse().unwrap_or(0));
    (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::release;

    #[test]
    fn versions_are_compared_as_numbers() {
        assert_eq!(release("4.5.15"), (4, 5));
        assert!(release("4.2.23") < (4, 4) && release("4.10") > (4, 4) && release("5.0.1") >= (5, 0));
        assert_eq!(release("unknown"), (0, 0));
    }
}
