//! An image in blocks of 4 × 4 pixels, to tell what a cache gets wrong from the noise of pixels.

use forelight_tracer::{Cost, Settings, Tracer};
use std::sync::atomic::{AtomicBool, Ordering};

/// Edge of a block, pixels.
const EDGE: u32 = 4;

/// An image, made twice from the same cache by independent camera samples. In products of one with the other, the
/// noise of camera samples drops out.
pub struct Blocks {
    /// Blocks in a row.
    across: usize,
    /// Mean of each block, over channels and pixels, in row-major order.
    images: [Vec<f64>; 2],
}

impl Blocks {
    /// The images by a tracer whose cache is filled, and their cost. Camera samples follow from `seed`: images
    /// with the same seed differ in their caches alone. Uses the current thread pool. `None` if `cancel` was set.
    pub(crate) fn of(tracer: &Tracer, seed: u64, cancel: &AtomicBool) -> Option<(Self, Cost)> {
        let Settings { width, height, spp, .. } = *tracer.settings();
        let pixels: Vec<u32> = (0..width * height).collect();
        let stop = || cancel.load(Ordering::Relaxed);
        let (traced, cost) = tracer.pixels_by(seed, &pixels, (2, spp), &stop)?;
        let across = width.div_ceil(EDGE) as usize;
        let images = [0, 1].map(|time| {
            let mut blocks = vec![(0.0, 0u32); across * height.div_ceil(EDGE) as usize];
            for (pixel, times) in (0..).zip(&traced) {
                let (x, y) = (pixel % width / EDGE, pixel / width / EDGE);
                let block = &mut blocks[y as usize * across + x as usize];
                block.0 += f64::from(times[time].color.iter().sum::<f32>()) / 3.0;
                block.1 += 1;
            }
            blocks.into_iter().map(|(sum, pixels)| sum / f64::from(pixels)).collect()
        });
        Some((Self { across, images }, cost))
    }

    /// Mean over the blocks.
    pub fn mean(&self) -> f64 {
        let [one, other] = &self.images;
        one.iter().chain(other).sum::<f64>() / (2 * one.len()).max(1) as f64
    }

    /// The differences from other images of the same size.
    pub fn minus(&self, other: &Self) -> Self {
        let differences = |time: usize| {
            let pairs = self.images[time].iter().zip(&other.images[time]);
            pairs.map(|(own, other)| own - other).collect()
        };
        Self { across: self.across, images: [differences(0), differences(1)] }
    }

    /// Mean square over the blocks. May be negative by chance.
    pub fn mean_square(&self) -> f64 {
        self.mean_product(self)
    }

    /// Mean over the blocks of the products with another image.
    pub fn mean_product(&self, other: &Self) -> f64 {
        let products = self.images[0].iter().zip(&other.images[1]).map(|(one, other)| one * other);
        products.sum::<f64>() / self.images[0].len().max(1) as f64
    }

    /// Mean product of blocks that lie so many pixels apart, across or down.
    pub fn mean_product_apart(&self, pixels: u32) -> f64 {
        let ([one, other], apart) = (&self.images, (pixels / EDGE) as usize);
        let (mut sum, mut pairs) = (0.0, 0u32);
        for (block, value) in one.iter().enumerate() {
            let beside = (block % self.across + apart < self.across).then_some(block + apart);
            for neighbour in [beside, Some(block + apart * self.across)].into_iter().flatten() {
                if let Some(there) = other.get(neighbour) {
                    sum += value * there;
                    pairs += 1;
                }
            }
        }
        sum / f64::from(pairs.max(1))
    }
}
