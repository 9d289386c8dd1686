//! What a submission is told about its scene.

use forelight_protocol::{FrameRate, SceneDigest, SceneSummary};
use forelight_scene::{Frame, Scene};

/// Describes a scene of our own. Image and triangles are those of `first`, its frame 0.
pub fn summary(scene: &Scene, first: &Frame) -> SceneSummary {
    let strata = scene.strata();
    SceneSummary {
        name: scene.name().to_owned(),
        digest: SceneDigest(scene.digest()),
        frames: scene.frame_count(),
        width: first.camera.width,
        height: first.camera.height,
        objects: strata.objects.len() as u64,
        materials: strata.materials() as u64,
        triangles: first.geometry.triangles.len() as u64,
        frames_per_second: FrameRate::try_from(scene.fps()).ok(),
    }
}
