//! A hash of everything that an image depends on.

use crate::Settings;
use forelight_scene::{Frame, Texels};

/// Raised when a change of the tracer changes images or counters: finished pixels of another version are not taken over.
const TRACER_VERSION: u32 = 3;

/// BLAKE3 of frame, settings and tracer version.
pub fn fingerprint(frame: &Frame, settings: &Settings) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
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
    // Small values by their debug form, which prints every float so that it reads back exactly.
    let small = format!(
        "{} {:?} {:?} {:?} {:?} {:?} {:?} {settings:?}",
        frame.number,
        frame.camera,
        geometry.strata,
        frame.materials,
        frame.points,
        frame.suns,
        frame.environment
    );
    hasher.update(small.as_bytes());
    *hasher.finalize().as_bytes()
}
