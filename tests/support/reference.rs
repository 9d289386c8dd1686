//! Reference images and our own, with their standard errors.

use crate::statistics::{Moments, Sample};
use forelight_scene::Scene;
use forelight_tracer::{Settings, Tracer};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// An image, and its mean over all pixels and channels.
pub struct Image {
    /// Every pixel.
    pub pixels: Estimate,
    /// The mean over the image.
    pub mean: Sample,
}

/// Mean and standard error of every pixel and channel, row-major, channels together.
pub struct Estimate {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Means, their variances, and the degrees of freedom.
    pub values: Vec<Sample>,
}

impl Estimate {
    /// The mean over the image. Its variance assumes independent pixels with fully correlated channels, which
    /// is an upper bound.
    pub fn mean(&self) -> Sample {
        let count = self.values.len() as f64;
        let error = |pixel: &[Sample]| pixel.iter().map(|v| v.variance.sqrt()).sum::<f64>();
        Sample {
            mean: self.values.iter().map(|v| v.mean).sum::<f64>() / count,
            variance: self.values.chunks_exact(3).map(|pixel| error(pixel).powi(2)).sum::<f64>()
                / (count * count),
            freedom: self.values.iter().map(|v| v.freedom).sum(),
        }
    }

    /// The same, with each variance raised to the mean over the 5 × 5 pixels around it. A pixel in a penumbra
    /// may miss its rare events in all passes and underestimate its variance.
    #[must_use]
    pub fn pooled(&self) -> Self {
        let (width, height) = (self.width as i64, self.height as i64);
        let at = |x: i64, y: i64, c: i64| self.values[((y * width + x) * 3 + c) as usize];
        let mut values = self.values.clone();
        for (i, value) in values.iter_mut().enumerate() {
            let (x, y, c) = (i as i64 / 3 % width, i as i64 / 3 / width, i as i64 % 3);
            let mut around = crate::statistics::Moments::default();
            for v in (y - 2).max(0)..(y + 3).min(height) {
                for u in (x - 2).max(0)..(x + 3).min(width) {
                    around.add(at(u, v, c).variance);
                }
            }
            value.variance = value.variance.max(around.sample().mean);
        }
        Self { values, ..*self }
    }

    /// Means over blocks of `edge` × `edge` pixels. They show small differences that all pixels share.
    #[must_use]
    pub fn blocks(&self, edge: u32) -> Self {
        let (width, height) = (self.width / edge, self.height / edge);
        let count = f64::from(edge * edge);
        let block = |i: u32| {
            let (x, y, c) = (i / 3 % width * edge, i / 3 / width * edge, i % 3);
            let mut block = Sample { mean: 0.0, variance: 0.0, freedom: 0.0 };
            for v in y..y + edge {
                for u in x..x + edge {
                    let sample = self.values[((v * self.width + u) * 3 + c) as usize];
                    block.mean += sample.mean / count;
                    block.variance += sample.variance / (count * count);
                    block.freedom += sample.freedom;
                }
            }
            block
        };
        Self { width, height, values: (0..width * height * 3).map(block).collect() }
    }
}

/// Reads a pair of EXR files: means, and their standard errors from this many independent passes.
pub fn read(mean: &Path, standard_error: &Path, passes: u32) -> Image {
    let open = |p: &Path| image::open(p).unwrap_or_else(|e| panic!("{}: {e}", p.display())).into_rgb32f();
    let (mean, error) = (open(mean), open(standard_error));
    let values = mean.as_raw().iter().zip(error.as_raw());
    let pixels = Estimate {
        width: mean.width(),
        height: mean.height(),
        values: values
            .map(|(&m, &e)| Sample {
                mean: f64::from(m),
                variance: f64::from(e).powi(2),
                freedom: f64::from(passes) - 1.0,
            })
            .collect(),
    };
    Image { mean: pixels.mean(), pixels }
}

/// Renders a frame `passes` times with different seeds, and estimates means and variances from the passes.
pub fn render(scene: &Path, frame: u32, settings: &Settings, passes: u32) -> Image {
    let scene = Scene::load(scene, &Default::default()).expect("the bundle loads");
    let frame = scene.frame(frame).expect("the frame exists");
    let mut bvh = None;
    let mut moments = vec![Moments::default(); (settings.width * settings.height * 3) as usize];
    let mut means = Moments::default();
    for seed in 0..u64::from(passes) {
        let settings = Settings { seed, ..settings.clone() };
        let tracer = match &bvh {
            None => Tracer::new(&frame, &settings),
            Some(tree) => Tracer::with_bvh(&frame, &settings, std::sync::Arc::clone(tree)),
        };
        bvh = Some(std::sync::Arc::clone(tracer.bvh()));
        let image = tracer.render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels");
        let mut sum = 0.0;
        for (m, value) in moments.iter_mut().zip(image.pixels.iter().flat_map(|p| p.color)) {
            m.add(f64::from(value));
            sum += f64::from(value);
        }
        means.add(sum / moments.len() as f64);
    }
    let values = moments.iter().map(Moments::sample).collect();
    Image {
        pixels: Estimate { width: settings.width, height: settings.height, values },
        mean: means.sample(),
    }
}
