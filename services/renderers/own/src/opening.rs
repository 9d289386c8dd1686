//! Our renderer, over `scene`, `preview` and `tracer`.

use crate::error::RenderError;
use crate::shot::OwnShot;
use forelight_preview::{Choice, PreviewError, Previewer};
use forelight_protocol::{PreviewBackend, RenderSettings, Spent, UncoveredGathers};
use forelight_scene::{Frame, Limits};
use forelight_tracer::Settings;
use parking_lot::Mutex;
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

/// The previewer, created on first use: opening a graphics device takes longer than many renders.
pub(crate) struct SharedPreviewer {
    choice: Choice,
    made: Mutex<Option<Previewer>>,
}

impl SharedPreviewer {
    pub fn with<T>(
        &self,
        work: impl FnOnce(&mut Previewer) -> Result<T, PreviewError>,
    ) -> Result<T, PreviewError> {
        let mut made = self.made.lock();
        let previewer = match &mut *made {
            Some(previewer) => previewer,
            none => none.insert(Previewer::new(self.choice)?),
        };
        work(previewer)
    }
}

impl OwnRenderer {
    /// A renderer that makes previews as `choice` says.
    pub fn new(choice: Choice) -> Self {
        let previewer = SharedPreviewer { choice, made: Mutex::default() };
        Self { previewer: Arc::new(previewer), limits: Limits::default() }
    }

    /// Opens the graphics device now, if previews use one, to fail at start rather than later.
    pub fn ready(&self) -> Result<(), PreviewError> {
        self.previewer.with(|_| Ok(()))
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

pub(crate) fn backend(previewer: &Previewer) -> PreviewBackend {
    if previewer.backend() == "gpu" { PreviewBackend::Gpu } else { PreviewBackend::Cpu }
}

/// Cost of the last preview. CPU work is in the tracer's weights. GPU work is one operation per pixel and
/// triangle. Time includes the device's, since a software driver runs on the same processor.
pub(crate) fn preview_spent(previewer: &Previewer, frame: &Frame, setup_nanos: u64) -> Spent {
    let cost = previewer.cost();
    let (pixels, triangles) = (frame.camera.pixels() as u64, frame.geometry.triangles.len() as u64);
    let work = match cost.nodes {
        0 => pixels + triangles,
        nodes => forelight_tracer::work(pixels, nodes, cost.triangles, 0, 0),
    };
    Spent { work, cpu_nanos: cost.cpu_nanos + cost.device_nanos + setup_nanos }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::CacheMode;
    use forelight_protocol::RenderSettingsRequest;
    use forelight_scene::Scene;

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

    #[test]
    fn a_preview_on_the_processor_is_charged_in_the_weights_of_rendering() {
        let folder = tempfile::tempdir().unwrap();
        let scene = r#"{"version":1,"name":"t","geometry":["t.obj"],
            "camera":{"origin":[0,0,4],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":4,"height":4}}"#;
        std::fs::write(folder.path().join("scene.json"), scene).unwrap();
        std::fs::write(folder.path().join("t.obj"), "v -9 -9 0\nv 9 -9 0\nv 0 9 0\nf 1 2 3\n").unwrap();
        let frame = Scene::load(folder.path(), &Limits::default()).unwrap().frame(0).unwrap();
        let mut previewer = Previewer::new(Choice::Cpu).unwrap();
        let counts = previewer.counts(&frame).unwrap();
        assert_eq!(counts.per_stratum, [16], "every ray meets the one triangle");
        let cost = previewer.cost();
        assert!(cost.nodes >= 16 && cost.triangles >= 16, "{cost:?}");
        let expected = forelight_tracer::work(16, cost.nodes, cost.triangles, 0, 0);
        assert_eq!(preview_spent(&previewer, &frame, 0).work, expected);
    }
}
