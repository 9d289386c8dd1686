//! Measures single pixels: their rays by kind, and their CPU time.
//!
//! One rtrace renders the pixels, and is paid for by the render, which takes them over. Another one prints
//! the trees of their rays, which are counted. Printing takes longer than tracing, so its time tells nothing
//! of a render's.
//!
//! The time of a single pixel is too short to be measured: the answer through a pipe takes as long. So groups
//! of pixels that show the same and are close to each other are measured together, and divided by the rays of
//! each.

use crate::ambient::Ambient;
use crate::blocks::SIDE;
use crate::finished::{self, Finished, Pixel};
use crate::ids::{self, Seen};
use crate::image::{PREPARE, mean};
use crate::opened::Opened;
use crate::rays::{Rays, rays_of};
use crate::scene::SceneFrame;
use crate::settings::{arguments, number, shares_values};
use crate::tracer::{Colour, Tracer};
use crate::tree::{Counter, Counts};
use forelight_renderer::door::{
    Artefact, Cost, FixedCosts, Part, PixelCost, PixelProfiler, ProfiledPixels, Renderer as _, RendererError,
    Run, Settings, Shown,
};
use std::sync::Arc;
use std::time::Instant;

/// Pixels that are measured together.
const GROUP: usize = 8;

/// Answers to nothing that are timed; their median counts.
const EMPTY_ANSWERS: usize = 15;

/// Measures pixels of a frame.
pub(crate) struct RadianceProfiler<'a> {
    opened: &'a Opened,
    frame: &'a SceneFrame,
    settings: &'a Settings,
    run: &'a Run<'a>,
    seen: Arc<Seen>,
    /// Values of indirect light that the pixels share.
    ambient: Option<Ambient>,
    /// Cost of finding what pixels show.
    seeing: Cost,
    values: Tracer,
    trees: Tracer,
    counter: Counter,
    /// CPU time of rtrace for an answer to nothing, nanoseconds.
    answer: u64,
    /// CPU time of rtrace before its first ray, nanoseconds.
    prepare: u64,
    /// CPU time of vwrays so far, nanoseconds.
    views: u64,
    finished: Finished,
    since: Instant,
}

impl<'a> RadianceProfiler<'a> {
    pub fn start(
        opened: &'a Opened,
        frame: &'a SceneFrame,
        settings: &'a Settings,
        run: &'a Run<'a>,
    ) -> Result<Self, RendererError> {
        let since = Instant::now();
        let quiet = Run { progress: &|_| {}, ..*run };
        let (seen, seeing) = opened.kept.take(opened, frame, &settings.common, &quiet)?;
        let arguments = opened.arguments(arguments(settings));
        let ambient = shares_values(settings).then(|| Ambient::new(run.scratch)).transpose()?;
        let with_file: Vec<String> =
            arguments.iter().cloned().chain(ambient.iter().flat_map(Ambient::arguments)).collect();
        let mut values = Tracer::of_values(&opened.radiance, &opened.scene, &frame.octree, &with_file, run)?;
        let trees = Tracer::of_trees(&opened.radiance, &opened.scene, &frame.octree, &arguments, run)?;
        let unknown = || RendererError::Failed("/proc does not say what a process used".to_owned());
        let prepare = values.warm(run)?.ok_or_else(unknown)?;
        let mut answers = Vec::with_capacity(EMPTY_ANSWERS);
        let mut before = prepare;
        for _ in 0..EMPTY_ANSWERS {
            let after = values.warm(run)?.ok_or_else(unknown)?;
            answers.push(after.saturating_sub(before));
            before = after;
        }
        answers.sort_unstable();
        let counter = Counter {
            halves: number(settings, "ambient_accuracy") > 0.0,
            most_specular: number(settings, "specular_sampling").clamp(1.0, 1e6) as usize,
        };
        Ok(Self {
            opened,
            frame,
            settings,
            run,
            seen,
            seeing,
            ambient,
            values,
            trees,
            counter,
            answer: answers[EMPTY_ANSWERS / 2],
            prepare,
            views: 0,
            finished: Finished::new(),
            since,
        })
    }

    /// Renders a group. Returns its values and the CPU time of rtrace, nanoseconds.
    fn render(&mut self, rays: &[[f64; 6]]) -> Result<(Vec<Colour>, u64), RendererError> {
        let before = self.values.cpu_nanos();
        let values = self.values.values(rays, self.run)?;
        let spent =
            self.values.cpu_nanos().zip(before).map_or(0, |(after, before)| after.saturating_sub(before));
        Ok((values, spent.saturating_sub(self.answer)))
    }

    /// CPU time of a pixel in a render beside tracing its rays, nanoseconds: that of vwrays, and its share of
    /// a block's answer.
    fn beside(&self) -> f64 {
        let pixels = self.seen.shown.len().max(1) as f64;
        let of_views = self.seen.view_nanos as f64 / pixels * f64::from(self.settings.common.samples);
        of_views + self.answer as f64 / f64::from(SIDE * SIDE)
    }
}

impl PixelProfiler for RadianceProfiler<'_> {
    fn shown(&self) -> &[Shown] {
        &self.seen.shown
    }

    fn measure(&mut self, pixels: &[u32]) -> Result<Vec<PixelCost>, RendererError> {
        let common = self.settings.common;
        let samples = common.samples as usize;
        let mut order: Vec<usize> = (0..pixels.len()).collect();
        let place = |&at: &usize| {
            let pixel = pixels[at];
            let shown = self.seen.shown.get(pixel as usize).copied();
            (shown, curve(pixel % common.width, pixel / common.width), pixel)
        };
        // Where pixels share values, the order is part of the question.
        if !shares_values(self.settings) {
            order.sort_by_key(place);
        }
        let sorted: Vec<u32> = order.iter().map(|&at| pixels[at]).collect();
        let of = (&self.opened.radiance, &self.opened.scene, self.frame);
        let Rays { rays, cpu_nanos } = rays_of(of, &common, &sorted, 0..common.samples, self.run)?;
        self.views += cpu_nanos;
        let beside = self.beside();
        let mut costs = vec![PixelCost::default(); pixels.len()];
        for (places, rays) in order.chunks(GROUP).zip(rays.chunks(GROUP * samples)) {
            let (values, nanos) = self.render(rays)?;
            let counts = self.trees.counts(rays, &self.counter, self.run)?;
            let of_pixels: Vec<Counts> = counts.chunks(samples).map(sum).collect();
            let all: u64 = of_pixels.iter().flatten().sum();
            for ((&at, rays), values) in places.iter().zip(of_pixels).zip(values.chunks(samples)) {
                let share = rays.iter().sum::<u64>() as f64 / all.max(1) as f64;
                let cpu_nanos = (nanos as f64 * share + beside).round() as u64;
                costs[at] = PixelCost { cpu_nanos, rays };
                self.finished.insert(pixels[at], Pixel { colour: mean(values), cpu_nanos });
            }
        }
        Ok(costs)
    }

    fn measure_runs(&mut self, runs: &[(Vec<u32>, usize)]) -> Result<Vec<PixelCost>, RendererError> {
        let common = self.settings.common;
        let samples = common.samples as usize;
        let beside = self.beside();
        let mut costs = Vec::with_capacity(runs.len());
        for (pixels, warming) in runs {
            let of = (&self.opened.radiance, &self.opened.scene, self.frame);
            let Rays { rays, cpu_nanos } = rays_of(of, &common, pixels, 0..common.samples, self.run)?;
            self.views += cpu_nanos;
            let (warming, measured) = rays.split_at(*warming.min(&pixels.len()) * samples);
            let (mut values, before) = self.render(warming)?;
            let (more, nanos) = self.render(measured)?;
            values.extend(more);
            let counts = self.trees.counts(measured, &self.counter, self.run)?;
            let of_measured = beside * (measured.len() / samples) as f64;
            costs.push(PixelCost {
                cpu_nanos: (nanos as f64 + of_measured).round() as u64,
                rays: sum(&counts),
            });
            let each = (before + nanos) as f64 / pixels.len().max(1) as f64 + beside;
            for (&pixel, values) in pixels.iter().zip(values.chunks(samples)) {
                let cpu_nanos = each.round() as u64;
                self.finished.insert(pixel, Pixel { colour: mean(values), cpu_nanos });
            }
        }
        Ok(costs)
    }

    fn finish(self: Box<Self>) -> Result<ProfiledPixels, RendererError> {
        let Self {
            opened,
            frame,
            settings,
            run,
            seen,
            seeing,
            ambient,
            values,
            trees,
            prepare,
            views,
            finished,
            since,
            ..
        } = *self;
        let path = run.scratch.join(format!("frame-{:04}-pixels", frame.number));
        let mut cost = seeing;
        cost.cpu_nanos += views;
        for tracer in [values, trees] {
            let used = tracer.finish(run)?.usage;
            cost.cpu_nanos += used.cpu_nanos;
            cost.peak_memory_bytes = cost.peak_memory_bytes.max(used.peak_memory_bytes);
        }
        // rtrace has written all of its values at its end.
        let ambient = ambient.map(|ambient| ambient.read()).transpose()?.unwrap_or_default();
        finished::write(&path, &finished, &ambient)?;
        cost.wall_nanos = u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX);
        let artefact = Artefact {
            renderer: opened.radiance.id().clone(),
            frame: frame.number,
            settings: settings.clone(),
            part: Part::Pixels(finished.keys().copied().collect()),
            path,
        };
        let fixed = FixedCosts::from([(PREPARE.to_owned(), prepare)]);
        let finished_nanos = finished.values().map(|pixel| pixel.cpu_nanos).sum();
        let ids = Some(ids::picture(&seen.shown, &settings.common));
        Ok(ProfiledPixels { cost, fixed, artefact: Some(artefact), finished_nanos, ids })
    }
}

fn sum(counts: &[Counts]) -> Counts {
    counts.iter().fold(Counts::default(), |mut sum, one| {
        sum.iter_mut().zip(one).for_each(|(sum, count)| *sum += count);
        sum
    })
}

/// Place of a pixel on a curve that keeps neighbours together: the bits of column and row in turn (Morton
/// 1966).
fn curve(x: u32, y: u32) -> u64 {
    let spread = |word: u32| (0..32).fold(0u64, |sum, bit| sum | u64::from(word >> bit & 1) << (2 * bit));
    spread(x) | spread(y) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_fills_squares_one_after_the_other() {
        let mut pixels: Vec<(u32, u32)> = (0..4).flat_map(|y| (0..4).map(move |x| (x, y))).collect();
        pixels.sort_by_key(|&(x, y)| curve(x, y));
        assert_eq!(pixels[..4], [(0, 0), (1, 0), (0, 1), (1, 1)]);
        assert!(pixels[12..].iter().all(|&(x, y)| x >= 2 && y >= 2));
    }

    #[test]
    fn counts_of_samples_add_up() {
        assert_eq!(sum(&[[1, 2, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 9, 0]]), [2, 2, 0, 0, 0, 9, 0]);
    }
}
