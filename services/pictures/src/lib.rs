//! Colours of pictures for people: rendered images and cost maps, the same for every renderer.

use image::{ImageError, ImageFormat, Rgb, RgbImage};
use std::io::Cursor;

/// A linear colour as 8-bit sRGB for viewing: a filmic curve with a soft shoulder above 0.6 per channel, then
/// the sRGB transfer function. Values that are not finite are black.
pub fn tone_map(color: [f32; 3]) -> [u8; 3] {
    const KNEE: f32 = 0.6;
    color.map(|c| {
        let c = if c.is_finite() { c.max(0.0) } else { 0.0 };
        let over = (c - KNEE).max(0.0) / (1.0 - KNEE);
        let display = if c <= KNEE { c } else { KNEE + (1.0 - KNEE) * (over / (1.0 + over)) };
        let encoded = if display <= 0.003_130_8 {
            12.92 * display
        } else {
            1.055 * libm::powf(display, 1.0 / 2.4) - 0.055
        };
        (encoded * 255.0 + 0.5) as u8
    })
}

/// Costs of pixels, in row-major order, in the false colours of Gillibrand et al. 2006 (figures 4 and 6), from
/// cyan (cheap) over blue to red (expensive). Linear up to the 99.5th percentile.
pub fn cost_map(width: u32, height: u32, costs: &[u64]) -> RgbImage {
    let mut sorted = costs.to_vec();
    sorted.sort_unstable();
    let at = |share: f64| {
        sorted.get((sorted.len().saturating_sub(1) as f64 * share) as usize).map_or(0.0, |&cost| cost as f32)
    };
    let (lowest, highest) = (at(0.0), at(0.995));
    let range = (highest - lowest).max(1.0);
    RgbImage::from_fn(width, height, |x, y| {
        let cost = costs.get((y * width + x) as usize).copied().unwrap_or(0);
        Rgb(cost_color((cost as f32 - lowest) / range))
    })
}

/// A picture as a PNG file.
///
/// # Errors
/// If the picture is too large to be encoded.
pub fn png(picture: &RgbImage) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    picture.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)?;
    Ok(bytes)
}

/// The false colours of a cost map: `t` in [0, 1] from cyan over blue, green and yellow to red.
pub fn cost_color(t: f32) -> [u8; 3] {
    const STOPS: [[f32; 3]; 6] = [
        [0.0, 0.9, 0.9],
        [0.0, 0.35, 0.95],
        [0.1, 0.1, 0.6],
        [0.1, 0.65, 0.2],
        [0.95, 0.85, 0.1],
        [0.85, 0.05, 0.05],
    ];
    let position = t.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let i = (position as usize).min(STOPS.len() - 2);
    let f = position - i as f32;
    std::array::from_fn(|c| ((STOPS[i][c] * (1.0 - f) + STOPS[i + 1][c] * f) * 255.0 + 0.5) as u8)
}

/// A colour for an object and its material: neighbours in number differ clearly. The hue is the object's, the
/// brightness the material's. Both by the golden ratio, so that no number of them repeats a colour.
pub fn id_color(object: u32, material: u32) -> [u8; 3] {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let hue = (f64::from(object) * GOLDEN).fract() * 6.0;
    let value = 0.55 + 0.45 * (f64::from(material) * GOLDEN).fract();
    let channel = |shift: f64| {
        let distance = ((hue + shift).rem_euclid(6.0) - 3.0).abs();
        // Between 0.25 and 1, so that no channel is dark.
        let strength = 0.25 + 0.75 * (distance - 1.0).clamp(0.0, 1.0);
        (value * strength * 255.0 + 0.5) as u8
    };
    [channel(0.0), channel(4.0), channel(2.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_dearest_pixel_is_red_and_the_cheapest_cyan() {
        let map = cost_map(2, 1, &[1, 1000]);
        assert_eq!((map.get_pixel(0, 0).0, map.get_pixel(1, 0).0), (cost_color(0.0), cost_color(1.0)));
        assert_eq!(cost_map(1, 1, &[]).get_pixel(0, 0).0, cost_color(0.0));
    }

    #[test]
    fn neighbouring_ids_have_clearly_different_colours() {
        let apart = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).map(|(a, b)| a.abs_diff(b)).max().unwrap();
        for id in 1..100 {
            assert!(apart(id_color(id, 1), id_color(id + 1, 1)) > 40, "{id}");
            assert!(apart(id_color(1, id), id_color(1, id + 1)) > 20, "{id}");
        }
    }

    #[test]
    fn display_values_rise_with_light_and_end_at_white() {
        assert_eq!(tone_map([0.0, f32::NAN, -1.0]), [0; 3]);
        let [low, middle, high] = tone_map([0.2, 0.6, 50.0]);
        assert!(low < middle && middle < high && high >= 253, "{low} {middle} {high}");
    }
}
