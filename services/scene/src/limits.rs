//! How much a bundle may ask for.

/// Bounds on what loading a bundle may cost. The defaults suit a machine with 16 GiB of memory and bundles
/// from people one does not know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Entries of an archive, or files read from a folder. Default 65 536.
    pub entries: usize,
    /// Bytes of all files together, after expansion. Default 4 GiB.
    pub total_bytes: u64,
    /// Bytes of one file, after expansion. Default 2 GiB.
    pub file_bytes: u64,
    /// How many bytes one compressed byte may become, for files that expand to more than 1 MiB. Default 200:
    /// geometry as text shrinks to a third or a tenth, deflate can do 1 032.
    pub compression_ratio: u64,
    /// Texels of all textures together. Default 2²⁸, 1 GiB as 8-bit images.
    pub texture_pixels: u64,
    /// Triangles, each instance of a mesh counted. Default 50 million.
    pub triangles: u64,
    /// Frames of the shot. Default 100 000.
    pub frames: u32,
    /// Pixels of the camera's image. Default 2²⁸.
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

/// Expanded size below which the compression ratio of a file does not matter.
pub(crate) const RATIO_MATTERS_FROM: u64 = 1 << 20;

/// Largest absolute coordinate of a vertex or of a camera, metres. Products of four such lengths still fit an `f32`, so that
/// no intersection test overflows.
pub(crate) const LARGEST_COORDINATE: f64 = 1e9;
