//! A picture of a preview, coloured as in the paper (Gillibrand et al. 2006).

use crate::preview::Preview;
use forelight_scene::{Frame, MaterialClass};
use image::{Rgb, RgbImage};

/// Colour of pixels that show no surface.
const BACKGROUND: Rgb<u8> = Rgb([8, 8, 10]);

/// A colour for every stratum, by its index.
///
/// The largest channel names the class of the material (the paper, section 2, step 1): red for transparent,
/// blue for specular and glossy, green for others. Within a class, colours are points of an additive
/// recurrence with the inverse powers of the root of x⁴ = x + 1. Successive ones differ strongly (Roberts
/// 2018, "The Unreasonable Effectiveness of Quasirandom Sequences").
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

/// The preview in the colours of [`palette`], darkened where surfaces turn away from the eye.
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
