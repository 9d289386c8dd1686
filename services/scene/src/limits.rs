//! Limits on the resources that a bundle may use.

use serde::{Deserialize, Serialize};

/// Limits on loading an untrusted bundle. Defaults suit a machine with 16 GiB of memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Number of entries of an archive, or of files read from a folder. Default 65,536.
    pub entries: usize,
    /// Bytes of all files together, after expansion. Default 4 GiB.
    pub total_bytes: u64,
    /// Bytes of one file, after expansion. Default 2 GiB.
    pub file_bytes: u64,
    /// Expanded bytes per compressed byte, for files that expand to more than 1 MiB. Default 200. Text
    /// geometry shrinks to a third to a tenth; Deflate can reach 1,032.
    pub compression_ratio: u64,
    /// Texels of all textures together. Default 2²⁸, which is 1 GiB as 8-bit images.
    pub texture_pixels: u64,
    /// Number of triangles. Each instance of a mesh counts. Default 50 million.
    pub triangles: u64,
    /// Number of frames in the shot. Default 100,000.
    pub frames: u32,
    /// Number of pixels in the camera's image. Default 2²⁸.
    pub image_pixels: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            entries: 65_536,
            total_bytes: 4 << 30,
            file_bytes: 2 << 30,
            compression_ratio: 200,
            texture_pixels: 1 << 28,
            triangles: 50_000_000,
            frames: 100_000,
            image_pixels: 1 << 28,
        }
    }
}

/// Files that expand to fewer bytes are exempt from the compression ratio.
pub(crate) const RATIO_MATTERS_FROM: u64 = 1 << 20;

/// Largest absolute coordinate, metres. Products of four such lengths still fit an `f32`.
pub(crate) const LARGEST_COORDINATE: f64 = 1e9;
