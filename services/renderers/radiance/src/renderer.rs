//! The renderer's side of the door: what Radiance is, what it can, and how a scene is opened.

use crate::installation::Radiance;
use crate::settings::SCHEMA;
use crate::shot::RadianceShot;
use forelight_renderer::door::{Capabilities, Capability, Renderer, RendererError, RendererId, Run, Shot};
use serde_json::Value;
use std::path::Path;

impl Renderer for Radiance {
    fn id(&self) -> &RendererId {
        &self.id
    }

    fn settings_schema(&self) -> Value {
        SCHEMA.clone()
    }

    fn capabilities(&self) -> Capabilities {
        Capabilities::from([
            Capability::MeasureSamples,
            Capability::MeasureRegions,
            Capability::MeasureManyRegions,
            Capability::MeasurePixels,
            Capability::TakeOverPixels,
            Capability::LocateCosts,
        ])
    }

    fn open(&self, scene: &Path, run: &Run<'_>) -> Result<Box<dyn Shot>, RendererError> {
        Ok(Box::new(RadianceShot::open(self.clone(), scene, run)?))
    }
}
