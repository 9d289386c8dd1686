//! Our renderer, over `scene`, `preview` and `tracer`.

use crate::error::RenderError;
use crate::previewer::SharedPreviewer;
use crate::shot::OwnShot;
use forelight_preview::{Choice, PreviewError};
use forelight_protocol::{RenderSettings, UncoveredGathers};
use forelight_scene::Limits;
use forelight_tracer::Settings;
use std::path::Path;
use std::sync::Arc;

/// Opens bundles with our renderer. They share one previewer, as a process has one graphics device.
#[derive(Clone)]
pub struct OwnRenderer {
    previewer: Arc<SharedPreviewer>,
    limits: Limits,
}

/// A graphics device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adapter {
    /// Name, kind and driver.
    pub name: String,
    /// Whether it is a graphics processor rather than software.
    pub is_hardware: bool,
}

impl OwnRenderer {
    /// A renderer that makes previews as `choice` says.
    pub fn new(choice: Choice) -> Self {
        Self { previewer: Arc::new(SharedPreviewer::new(choice)), limits: Limits::default() }
    }

    /// The graphics device for previews. `None` if previews are made on the CPU.
    pub fn adapter(&self) -> Result<Option<Adapter>, PreviewError> {
        self.previewer.with(|previewer| {
            let adapter =
                |name: &str| Adapter { name: name.to_owned(), is_hardware: previewer.is_hardware() };
            Ok(previewer.adapter().map(adapter))
        })
    }

    /// Opens a bundle.
    pub fn open(&self, path: &Path) -> Result<OwnShot, RenderError> {
        OwnShot::open(path, &self.limits, self.previewer.clone())
    }
}

/// How a frame gathers at uncovered points. `None` without an irradiance cache.
pub(crate) fn uncovered_gathers(settings: &RenderSettings) -> Option<UncoveredGathers> {
    let forelight_tracer::UncoveredGathers { first, least } = Settings::from(settings).cache?.uncovered();
    Some(UncoveredGathers { first, least })
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::CacheMode;
    use forelight_protocol::RenderSettingsRequest;

    #[test]
    fn a_profile_says_how_the_tracer_gathers_where_no_record_is() {
        let request = RenderSettingsRequest {
            cache: Some(CacheMode::On),
            cache_rays: Some(768),
            cache_accuracy: Some(150),
            ..RenderSettingsRequest::default()
        };
        let settings = request.complete((64, 36));
        let said = uncovered_gathers(&settings).unwrap();
        let done = Settings::from(&settings).cache.unwrap().uncovered();
        let above =
            |samples: u32| (1..=samples).map(|n| f64::from(done.of_sample(n) - done.least)).sum::<f64>();
        for (from, to) in [(1, 2), (4, 16), (16, 4), (64, 1000)] {
            assert_eq!(said.growth(from, to), above(to) / above(from));
        }
        assert_eq!(uncovered_gathers(&RenderSettings { cache: CacheMode::Off, ..settings }), None);
    }
}
