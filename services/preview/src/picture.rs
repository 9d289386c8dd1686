//! The paper's picture of a preview.

use crate::preview::Preview;
use forelight_scene::{Frame, MaterialClass};
use image::{Rgb, RgbImage};

/// What no surface covers.
const BACKGROUND: Rgb<u8> = Rgb([8, 8, 10]);

/// A colour for every stratum, by its index: mostly red for transparent, mostly blue for specular and glossy, mostly
/// green for all others (the paper, section 2, step 1). The largest channel always names the class.
///
/// Within a class, the colours are the points of an additive recurrence with the inverse powers of the root of
/// x⁴ = x + 1, the golden ratio's relative in three dimensions (Roberts 2018, "The Unreasonable Effectiveness of
/// Quasirandom Sequences"): any number of them fill the range evenly, and one is far from the next.
pub fn palette(frame: &Frame) -> Vec<[u8; 3]> {
    const ROOT: f64 = 1.220_744_084_605_759_5;
    let mut ranks = [0u32; 3];
    let colour = |&(_, material): &(u32, u32)| {
        let channel = match frame.materials[material as usize].class() {
            MaterialClass::Transparent => 0,
            MaterialClass::Diffuse => 1,
            MaterialClass::Specular => 2,
        };
        ranks[channel] += 1;
        let rank = f64::from(ranks[channel]);
        let mut step = 1.0;
        let mut next = || {
            step /= ROOT;
            (0.5 + rank * step).fract()
        };
        let mut rgb = [0; 3];
        rgb[channel] = (145.0 + 110.0 * next()) as u8;
        rgb[(channel + 1) % 3] = (105.0 * next()) as u8;
        rgb[(channel + 2) % 3] = (105.0 * next()) as u8;
        rgb
    };
    frame.geometry.strata.pairs.iter().map(colour).collect()
}

/// The preview as a picture: [`palette`]'s colours, darkened where a surface turns away from the eye so that shapes read.
pub fn picture(preview: &Preview, frame: &Frame) -> RgbImage {
    let palette = palette(frame);
    let mut image = RgbImage::from_pixel(preview.width, preview.height, BACKGROUND);
    for (pixel, out) in image.pixels_mut().enumerate() {
        let Some(colour) = palette.get(preview.stratum[pixel] as usize) else { continue };
        let to_eye = (frame.camera.origin - preview.position[pixel]).normalize_or_zero();
        let light = 0.7 + 0.3 * preview.normal[pixel].dot(to_eye).abs();
        *out = Rgb(colour.map(|channel| (f32::from(channel) * light) as u8));
    }
    image
}
