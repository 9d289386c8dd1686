//! Draws the positions of profiled pixels.

use image::{Rgb, RgbImage};

/// Enlargement of the image.
const ZOOM: u32 = 2;

/// Brightness of the image behind the dots.
const DIMMED: f32 = 0.45;

/// The profiled pixels as white dots on a darkened, enlarged picture (figure 3 of the paper).
pub fn positions(behind: &RgbImage, pixels: impl Iterator<Item = u32>) -> RgbImage {
    let (width, height) = behind.dimensions();
    let dim = |Rgb(colour): &Rgb<u8>| Rgb(colour.map(|channel| (f32::from(channel) * DIMMED) as u8));
    let mut picture =
        RgbImage::from_fn(ZOOM * width, ZOOM * height, |x, y| dim(behind.get_pixel(x / ZOOM, y / ZOOM)));
    for pixel in pixels {
        let (x, y) = (ZOOM * (pixel % width), ZOOM * (pixel / width));
        for (dx, dy) in (0..=ZOOM).flat_map(|dy| (0..=ZOOM).map(move |dx| (dx, dy))) {
            if let Some(out) = picture.get_pixel_mut_checked(x + dx, y + dy) {
                *out = Rgb([255; 3]);
            }
        }
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profiled_pixel_is_a_white_dot_and_the_rest_is_dimmed() {
        let behind = RgbImage::from_pixel(4, 3, Rgb([200; 3]));
        let picture = positions(&behind, [6u32, 11].into_iter());
        assert_eq!(picture.dimensions(), (8, 6));
        assert_eq!(*picture.get_pixel(4, 2), Rgb([255; 3]));
        assert_eq!(*picture.get_pixel(0, 0), Rgb([90; 3]));
    }
}
