//! What previews cost, and where they were made.

use forelight_preview::Previewer;
use forelight_protocol::{PreviewBackend, Spent};
use forelight_scene::Frame;

pub(crate) fn backend(previewer: &Previewer) -> PreviewBackend {
    if previewer.backend() == "gpu" { PreviewBackend::Gpu } else { PreviewBackend::Cpu }
}

/// Cost of the last preview. CPU work is in the tracer's weights. GPU work is one operation per pixel and
/// triangle.
pub(crate) fn preview_spent(previewer: &Previewer, frame: &Frame, setup_nanos: u64) -> Spent {
    let cost = previewer.cost();
    let (pixels, triangles) = (frame.camera.pixels() as u64, frame.geometry.triangles.len() as u64);
    let work = match cost.nodes {
        0 => pixels + triangles,
        nodes => forelight_tracer::work(pixels, nodes, cost.triangles, 0, 0),
    };
    Spent { work, cpu_nanos: cost.nanos() + setup_nanos }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_preview::Choice;
    use forelight_scene::{Limits, Scene};

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
