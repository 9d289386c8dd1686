//! Fingerprints: hashes of everything that an image, or a cache record, depends on.

use crate::{Reach, SampleCounts, Settings};
use blake3::Hasher;
use forelight_scene::{Frame, Texels};

/// Increase this when images or counters change. Pixels of another version are not reused.
const TRACER_VERSION: u32 = 17;

/// BLAKE3 hash of frame, settings and tracer version. `content` is [`of_content`] of the frame.
pub fn fingerprint(
    content: &Hasher,
    frame: &Frame,
    settings: &Settings,
    samples: Option<&SampleCounts>,
) -> [u8; 32] {
    let mut hasher = content.clone();
    hasher.update(format!("{} {:?} {settings:?}", frame.number, frame.camera).as_bytes());
    if let Some(samples) = samples {
        hasher.update(bytemuck::cast_slice(samples.as_slice()));
    }
    *hasher.finalize().as_bytes()
}

/// Fingerprint of the light: like [`fingerprint`], but without camera, frame number, image size and samples.
/// It includes which lights can reach anything visible.
pub fn light_fingerprint(content: &Hasher, settings: &Settings, reach: &Reach) -> [u8; 32] {
    let mut hasher = content.clone();
    let Settings { integrator, ambient_bounces, max_depth, materials, cache, seed, .. } = settings;
    let small = format!(
        "{integrator:?} {ambient_bounces} {max_depth} {materials:?} {cache:?} {seed} {:?}",
        reach.lights()
    );
    hasher.update(small.as_bytes());
    *hasher.finalize().as_bytes()
}

/// Hash of everything that does not depend on the view: geometry, textures, materials, lights, tracer
/// version.
pub fn of_content(frame: &Frame) -> Hasher {
    let mut hasher = Hasher::new();
    let geometry = &frame.geometry;
    hasher.update(&TRACER_VERSION.to_le_bytes());
    hasher.update(bytemuck::cast_slice(&geometry.positions));
    hasher.update(bytemuck::cast_slice(&geometry.normals));
    hasher.update(bytemuck::cast_slice(&geometry.uvs));
    hasher.update(bytemuck::cast_slice(&geometry.triangles));
    hasher.update(bytemuck::cast_slice(&geometry.triangle_stratum));
    for texture in frame.textures.iter() {
        hasher.update(&texture.width.to_le_bytes());
        match &texture.texels {
            Texels::Srgb8(texels) => hasher.update(bytemuck::cast_slice(texels)),
            Texels::Linear(texels) => hasher.update(bytemuck::cast_slice(texels)),
        };
    }
    // Small values are hashed in their debug form, which prints every float so that it reads back exactly.
    let small = format!(
        "{:?} {:?} {:?} {:?} {:?}",
        geometry.strata, frame.materials, frame.points, frame.suns, frame.environment
    );
    hasher.update(small.as_bytes());
    hasher
}

/// Version of the tracer. Images and counters of different versions may differ.
pub fn tracer_version() -> u32 {
    TRACER_VERSION
}
