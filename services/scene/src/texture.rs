//! Images for surfaces and for the environment.

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Index into [`crate::Frame::textures`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct TextureId(pub u32);

/// Stored texels. 8-bit images stay 8-bit to save memory. HDR images are linear floats.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Texels {
    /// sRGB-encoded colour with linear alpha.
    #[serde(with = "crate::bulk")]
    Srgb8(Vec<[u8; 4]>),
    /// Linear RGB.
    #[serde(with = "crate::bulk")]
    Linear(Vec<[f32; 3]>),
}

/// An image with bilinear, repeating lookup.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Texture {
    /// Path in the bundle, for error messages.
    pub name: String,
    /// Width in texels, at least 1.
    pub width: u32,
    /// Height in texels, at least 1.
    pub height: u32,
    /// Texels in row-major order. The first row is the top of the image.
    pub texels: Texels,
}

impl Texture {
    /// Linear colour at texture coordinates `uv`, bilinear and repeating. v = 0 is the bottom edge.
    pub fn color(&self, uv: Vec2) -> Vec3 {
        self.bilinear(uv, |texel| self.texel_color(texel))
    }

    /// Linear colour of a latitude-longitude image. v does not repeat, because its ends are the poles.
    pub fn sky(&self, uv: Vec2) -> Vec3 {
        // Stay half a texel away from the edges, where the opposite row would be mixed in.
        let half = 0.5 / self.height as f32;
        self.color(Vec2::new(uv.x, uv.y.clamp(half, 1.0 - half)))
    }

    /// Alpha at `uv`. 1 for images without alpha.
    pub fn alpha(&self, uv: Vec2) -> f32 {
        match &self.texels {
            Texels::Srgb8(t) => self.bilinear(uv, |i| Vec3::splat(t[i][3] as f32 / 255.0)).x,
            Texels::Linear(_) => 1.0,
        }
    }

    /// Linear colour of one texel by its row-major index.
    pub fn texel_color(&self, index: usize) -> Vec3 {
        match &self.texels {
            Texels::Srgb8(t) => {
                let [r, g, b, _] = t[index];
                Vec3::new(SRGB[r as usize], SRGB[g as usize], SRGB[b as usize])
            }
            Texels::Linear(t) => Vec3::from_array(t[index]),
        }
    }

    fn bilinear(&self, uv: Vec2, texel: impl Fn(usize) -> Vec3) -> Vec3 {
        let (x0, x1, fx) = wrap(uv.x, self.width);
        let (y0, y1, fy) = wrap(1.0 - uv.y, self.height);
        let row = |y: usize| {
            let (a, b) = (texel(y * self.width as usize + x0), texel(y * self.width as usize + x1));
            a + (b - a) * fx
        };
        let (top, bottom) = (row(y0), row(y1));
        top + (bottom - top) * fy
    }
}

/// The two texels on either side of coordinate `s` (repeating), and the fraction towards the second.
fn wrap(s: f32, size: u32) -> (usize, usize, f32) {
    let s = if s.is_finite() { s - s.floor() } else { 0.0 };
    let x = s * size as f32 - 0.5;
    let floor = x.floor();
    let first = (floor as i64).rem_euclid(size as i64) as usize;
    let second = if first + 1 == size as usize { 0 } else { first + 1 };
    (first, second, x - floor)
}

/// sRGB decoding table (IEC 61966-2-1), computed at compile time to f32 precision.
static SRGB: [f32; 256] = srgb_table();

const fn srgb_table() -> [f32; 256] {
    let mut table = [0.0; 256];
    let mut i = 0;
    while i < 256 {
        let s = i as f64 / 255.0;
        table[i] = if s <= 0.04045 { s / 12.92 } else { pow_2_4((s + 0.055) / 1.055) } as f32;
        i += 1;
    }
    table
}

/// x^2.4 = x² · (x²)^(1/5), with the fifth root by Newton's method. x must be in (0, 1].
const fn pow_2_4(x: f64) -> f64 {
    let square = x * x;
    let mut root = 1.0;
    let mut i = 0;
    while i < 60 {
        let r4 = root * root * root * root;
        root -= (root * r4 - square) / (5.0 * r4);
        i += 1;
    }
    square * root
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_decodes_to_the_standard_curve() {
        for (i, &linear) in SRGB.iter().enumerate() {
            let s = i as f64 / 255.0;
            let expected = if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) };
            assert!((linear as f64 - expected).abs() < 1e-7, "{i}: {linear} against {expected}");
        }
    }

    #[test]
    fn v_points_up_and_lookups_repeat() {
        let texels = Texels::Linear(vec![[1.0; 3], [1.0; 3], [0.0; 3], [0.0; 3]]);
        let t = Texture { name: "t".into(), width: 2, height: 2, texels };
        assert_eq!(t.color(Vec2::new(0.25, 0.75)), Vec3::ONE);
        assert_eq!(t.color(Vec2::new(0.25, 0.25)), Vec3::ZERO);
        assert_eq!(t.color(Vec2::new(7.25, -3.25)), Vec3::ONE);
    }
}
