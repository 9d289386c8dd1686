//! Images as plain numbers, and distances between them.

use anyhow::{Context, Result, bail};
use forelight_tracer::Image;
use image::{ImageFormat, Rgb, Rgb32FImage, RgbImage};
use std::path::Path;

/// Linear Rec. 709 values, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// One colour per pixel.
    pub pixels: Vec<[f32; 3]>,
}

/// Distance of an image from a reference, relative to the reference's mean.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Distance {
    /// Root mean square over pixels and channels.
    pub rmse: f64,
    /// The same without pixels that see a light in the reference, or are next to one, relative to the mean of
    /// the rest. Edges of lights would outweigh all else.
    pub lit: f64,
    /// Mean of the image / mean of the reference − 1.
    pub bias: f64,
}

/// A pixel sees a light if it is this many times as bright as the median of the non-black ones.
const LIGHT: f32 = 10.0;

impl Picture {
    pub fn of(image: &Image) -> Self {
        let traced = || image.pixels.iter().map(|pixel| pixel.color).collect();
        let pixels = image.denoised.as_ref().map_or_else(traced, |denoised| denoised.colors.clone());
        Self { width: image.width, height: image.height, pixels }
    }

    pub fn read(path: &Path) -> Result<Self> {
        let context = || format!("{}", path.display());
        let image = image::open(path).with_context(context)?.into_rgb32f();
        let (width, height) = image.dimensions();
        Ok(Self { width, height, pixels: image.pixels().map(|pixel| pixel.0).collect() })
    }

    pub fn write(&self, path: &Path) -> Result<()> {
        let image = Rgb32FImage::from_fn(self.width, self.height, |x, y| Rgb(self.at(x, y)));
        image
            .save_with_format(path, ImageFormat::OpenExr)
            .with_context(|| format!("cannot write {}", path.display()))
    }

    pub fn mean(&self) -> f64 {
        mean(self.pixels.iter())
    }

    /// Distance from a reference of the same size.
    pub fn distance(&self, reference: &Self) -> Result<Distance> {
        if (self.width, self.height) != (reference.width, reference.height) {
            bail!(
                "cannot compare an image of {} x {} pixels with a reference of {} x {}",
                self.width,
                self.height,
                reference.width,
                reference.height
            );
        }
        let lit = reference.lit();
        let pairs = || self.pixels.iter().zip(&reference.pixels);
        let lit = || pairs().zip(&lit).filter(|(_, lit)| **lit).map(|(pair, _)| pair);
        Ok(Distance {
            rmse: relative(root_mean_square(pairs()), reference.mean()),
            lit: relative(root_mean_square(lit()), mean(lit().map(|pair| pair.1))),
            bias: relative(self.mean() - reference.mean(), reference.mean()),
        })
    }

    /// Pixels that neither see a light nor are next to one that does.
    fn lit(&self) -> Vec<bool> {
        // Black pixels are left out, because the scene may fill less than half of the image.
        let mut sorted: Vec<f32> = self.pixels.iter().map(brightness).filter(|&sum| sum > 0.0).collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let limit = LIGHT * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let (width, height) = (self.width, self.height);
        let around = |i: u32, size: u32| i.saturating_sub(1)..(i + 2).min(size);
        let dark = |x: u32, y: u32| {
            around(y, height).all(|v| around(x, width).all(|u| brightness(&self.at(u, v)) <= limit))
        };
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| dark(x, y)).collect()
    }

    /// Signed difference from a reference, for display: mid grey is none, black and white are −`range` and
    /// +`range`, relative to the reference's mean.
    pub fn difference(&self, reference: &Self, range: f64) -> RgbImage {
        // Black images do not differ, whatever the scale.
        let scale = 127.5 / (range * reference.mean()).max(1e-300);
        RgbImage::from_fn(self.width, self.height, |x, y| {
            let (own, known) = (self.at(x, y), reference.at(x, y));
            let shade = |c: usize| 127.5 + (f64::from(own[c]) - f64::from(known[c])) * scale;
            Rgb(std::array::from_fn(|c| shade(c).round().clamp(0.0, 255.0) as u8))
        })
    }

    fn at(&self, x: u32, y: u32) -> [f32; 3] {
        self.pixels[(y * self.width + x) as usize]
    }
}

fn brightness(pixel: &[f32; 3]) -> f32 {
    pixel.iter().sum()
}

fn mean<'a>(pixels: impl Iterator<Item = &'a [f32; 3]>) -> f64 {
    let (sum, count) = pixels.fold((0.0, 0u64), |(sum, count), pixel| {
        (sum + pixel.iter().map(|&v| f64::from(v)).sum::<f64>(), count + 3)
    });
    sum / count.max(1) as f64
}

/// A distance of zero is zero relative to any mean.
fn relative(distance: f64, mean: f64) -> f64 {
    if distance == 0.0 { 0.0 } else { distance / mean }
}

fn root_mean_square<'a>(pairs: impl Iterator<Item = (&'a [f32; 3], &'a [f32; 3])>) -> f64 {
    let (sum, count) = pairs.fold((0.0, 0u64), |(sum, count), (a, b)| {
        let squares = a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2));
        (sum + squares.sum::<f64>(), count + 3)
    });
    (sum / count.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Picture {
        Picture { width: values.len() as u32, height: 1, pixels: values.iter().map(|&v| [v; 3]).collect() }
    }

    #[test]
    fn a_distance_is_relative_to_the_mean_and_has_a_variant_without_lights() {
        let mut values = vec![1.0; 1000];
        values[7] = 1001.0;
        let reference = grey(&values);
        values[7] = 901.0;
        values[8] = 1.8;
        values[500] = 1.5;
        let distance = grey(&values).distance(&reference).unwrap();
        let expected = ((100.0f64.powi(2) + 0.64 + 0.25) / 1000.0).sqrt() / 2.0;
        assert!((distance.rmse / expected - 1.0).abs() < 1e-6, "{distance:?}");
        // The light and its two neighbours are left out.
        assert!((distance.lit / (0.25f64 / 997.0).sqrt() - 1.0).abs() < 1e-6, "{distance:?}");
        assert!((distance.bias - (-98.7 / 2000.0)).abs() < 1e-6, "{distance:?}");
    }

    #[test]
    fn a_scene_in_the_middle_of_nothing_has_lit_pixels_and_one_in_the_dark_no_distance() {
        let mut values = vec![0.0; 1000];
        values[400..600].fill(1.0);
        let reference = grey(&values);
        values[500] = 1.5;
        let distance = grey(&values).distance(&reference).unwrap();
        assert!((distance.lit / ((0.25f64 / 1000.0).sqrt() / 0.2) - 1.0).abs() < 1e-6, "{distance:?}");
        let dark = grey(&[0.0; 9]);
        assert_eq!(dark.distance(&dark).unwrap(), Distance { rmse: 0.0, lit: 0.0, bias: 0.0 });
    }

    #[test]
    fn images_of_other_sizes_are_not_compared() {
        assert!(grey(&[1.0]).distance(&grey(&[1.0, 2.0])).is_err());
    }

    #[test]
    fn an_image_comes_back_from_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let picture = Picture { width: 2, height: 1, pixels: vec![[0.25, 1e-4, 3.5], [17.0, 0.0, 1.0]] };
        picture.write(&path).unwrap();
        assert_eq!(Picture::read(&path).unwrap(), picture);
    }

    #[test]
    fn a_difference_is_grey_where_there_is_none() {
        let image = grey(&[1.0, 1.1, 0.5]).difference(&grey(&[1.0, 1.0, 1.0]), 0.2);
        assert_eq!(image.pixels().map(|p| p.0[0]).collect::<Vec<_>>(), [128, 191, 0]);
    }
}
