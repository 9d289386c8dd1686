//! What a task says of its progress.

use crate::accuracy::AccuracyObserver;
use crate::answers::{Progress, Step};
use crate::profile::Observer;
use forelight_protocol::FinishedPixels;
use forelight_renderer::Control;
use forelight_tracer::{Pixel, Totals};
use std::sync::atomic::AtomicBool;

/// Reports finished pixels, of `all`, and their cost.
pub(crate) fn count(pixels: &[(u32, Pixel)], all: u64, control: &Control) {
    let Totals { pixels: done, work, cpu_nanos, .. } = Totals::of(pixels.iter().map(|(_, pixel)| pixel));
    control.finished_pixels(FinishedPixels { done, all, work, cpu_nanos });
}

/// Progress of a render, 0 to 1. Filling an irradiance cache takes about half of it.
pub(crate) fn fraction(Progress { step, done, all }: Progress, cached: bool) -> f64 {
    let part = done as f64 / all.max(1) as f64;
    match (step, cached) {
        (Step::Planning, _) => 0.0,
        (Step::Filling, _) => 0.5 * part,
        (Step::Tracing, true) => 0.5 + 0.5 * part,
        (Step::Tracing, false) => part,
        (Step::Denoising, _) => 1.0,
    }
}

/// Share of a render task's progress before the noise of its image is removed.
pub(crate) const NOISY: f64 = 0.85;

/// Reports the steps of a quote as progress of the task.
pub(crate) struct Reporting<'a> {
    pub control: &'a Control,
    /// The range of the task's progress that this covers, 0 to 1.
    pub from: f64,
    pub to: f64,
}

impl<'a> Reporting<'a> {
    /// Over the whole task.
    pub fn all(control: &'a Control) -> Self {
        Self { control, from: 0.0, to: 1.0 }
    }

    fn report(&self, done: usize, all: usize) {
        let part = done as f64 / all.max(1) as f64;
        self.control.set_progress(self.from + part * (self.to - self.from));
    }
}

impl Observer for Reporting<'_> {
    fn previewed(&self, done: usize, all: usize) {
        self.report(done, all);
    }

    fn profiled(&self, done: usize, all: usize) {
        self.report(done, all);
    }

    fn is_cancelled(&self) -> bool {
        self.control.is_cancelled()
    }
}

impl AccuracyObserver for Reporting<'_> {
    fn predicted(&self, done: usize, all: usize) {
        self.report(done, all);
    }

    fn cancel(&self) -> &AtomicBool {
        self.control.cancelled()
    }
}
