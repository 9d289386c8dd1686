//! Pictures of pixel costs, in the paper's colours.

use forelight_pictures::cost_color;
use image::{Rgb, RgbImage};

/// The colours of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paint {
    /// From cyan (least) over blue to red (most), as in figures 4, 6 and 8.
    Colour,
    /// From black (least) to white (most), as in figures 5, 7 and 9.
    Grey,
}

/// The range of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Value of the first colour. Lower values have it too.
    pub lowest: f64,
    /// Value of the last colour. Higher values have it too.
    pub highest: f64,
}

/// Share of the pixels that may lie outside the scale, so that a few extremes do not flatten the rest. Costs that a
/// renderer locates by blocks and by the clock have such extremes: the system interrupted a block. In a picture of
/// 96 × 96 pixels, one is 0.7 %.
const OFF_SCALE: f64 = 0.02;

impl Scale {
    /// From the least value to one that only `OFF_SCALE` of the values exceed.
    pub fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| sorted.get((sorted.len().max(1) as f64 * share) as usize).copied();
        let (lowest, highest) = (at(0.0).unwrap_or(0.0), at(1.0 - OFF_SCALE).unwrap_or(0.0));
        Self { lowest, highest: if highest > lowest { highest } else { lowest + 1.0 } }
    }

    fn place(&self, value: f64) -> f32 {
        ((value - self.lowest) / (self.highest - self.lowest)) as f32
    }
}

/// A picture of one value per pixel, in row order.
pub fn map(width: u32, values: &[f64], scale: Scale, paint: Paint) -> RgbImage {
    let height = values.len() as u32 / width.max(1);
    RgbImage::from_fn(width, height, |x, y| Rgb(colour(scale.place(values[(y * width + x) as usize]), paint)))
}

/// Width and height of a key, pixels.
const KEY: (u32, u32) = (256, 12);

/// The key of the colours, from least to most.
pub fn key(paint: Paint) -> RgbImage {
    RgbImage::from_fn(KEY.0, KEY.1, |x, _| Rgb(colour(x as f32 / (KEY.0 - 1) as f32, paint)))
}

fn colour(place: f32, paint: Paint) -> [u8; 3] {
    match paint {
        Paint::Colour => cost_color(place),
        Paint::Grey => [(place.clamp(0.0, 1.0) * 255.0).round() as u8; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_leaves_out_what_is_rare_and_is_never_of_no_width() {
        let mut values: Vec<f64> = (0..1000).map(f64::from).collect();
        values[999] = 1e9;
        assert_eq!(Scale::of(&values), Scale { lowest: 0.0, highest: 980.0 });
        assert_eq!(Scale::of(&[3.0; 10]), Scale { lowest: 3.0, highest: 4.0 });
        assert_eq!(Scale::of(&[]), Scale { lowest: 0.0, highest: 1.0 });
    }

    #[test]
    fn the_least_is_cyan_or_black_and_the_most_red_or_white() {
        let scale = Scale { lowest: 1.0, highest: 3.0 };
        let colours = map(2, &[1.0, 9.0], scale, Paint::Colour);
        let [Rgb([r, g, b]), Rgb([red, green, blue])] = [*colours.get_pixel(0, 0), *colours.get_pixel(1, 0)];
        assert!(r < 30 && g > 200 && b > 200 && red > 200 && green < 30 && blue < 30);
        let greys = map(3, &[1.0, 2.0, 3.0], scale, Paint::Grey);
        assert_eq!([0, 1, 2].map(|x| greys.get_pixel(x, 0).0[0]), [0, 128, 255]);
    }
}
