//! Makes all forecasts of one frame.

use super::figures::{self, File};
use super::level::{LADDER, Level, Seen, Task, Truth};
use super::noise;
use super::study::{Curve, CurvePoint, LevelStudy, Study};
use super::trial::{self, Columns, Forecast, Outcome, Records, Score};
use anyhow::Result;
use forelight_forecast::Strategy;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use rayon::prelude::*;
use std::path::Path;

/// What is forecast, and how often.
pub struct Asked<'a> {
    pub name: String,
    /// Renderer of the frame. `None`: our own.
    pub renderer: Option<String>,
    pub frame: u32,
    pub size: u32,
    pub gather_rays: u32,
    pub samples: u32,
    pub seeds: u32,
    pub pool: &'a rayon::ThreadPool,
}

/// Measures and forecasts the frame with our own renderer, and adds its figures, below `folder`, to `files`.
pub fn study(
    task: Task<'_>,
    folder: &str,
    files: &mut Vec<File>,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Study> {
    let Task { local, frame, size, gather_rays, samples, seeds, .. } = task;
    for level in Level::ALL {
        level
            .settings(size, gather_rays)
            .check()
            .map_err(|wrong| BadInput::new(format!("--size or --gather-rays: {}", wrong.reason)))?;
    }
    let measured = task.measure(bars, interrupt)?;
    let (name, pool) = (local.shot.info().summary.name.clone(), &local.pool);
    let asked = Asked { name, renderer: None, frame, size, gather_rays, samples, seeds, pool };
    forecasts(asked, measured, folder, files, bars, interrupt)
}

/// Forecasts a frame whose costs are known, and adds its figures, below `folder`, to `files`.
pub fn forecasts(
    asked: Asked<'_>,
    (seen, truths): (Seen, Vec<Truth>),
    folder: &str,
    files: &mut Vec<File>,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Study> {
    let trials = Trials { asked: &asked, seen: &seen, interrupt };
    let steps = 2 * truths.len();
    let bar = bars.bar("forecasts", (steps * Strategy::ALL.len()) as u64);
    let done = || bar.inc(1);
    let mut levels = Vec::with_capacity(truths.len());
    for truth in &truths {
        levels.push(trials.at(truth, &done)?);
    }
    let mut curves = Vec::new();
    for truth in &truths {
        for strategy in Strategy::ALL {
            curves.push(trials.curve(strategy, truth)?);
            done();
        }
    }
    bar.finish_and_clear();
    files.extend(figures::of(Path::new(folder), &seen, &truths, &curves, asked.size, asked.samples)?);
    let mut shown = seen.ids.clone();
    shown.sort_unstable();
    shown.dedup();
    let Asked { name, renderer, frame, size, gather_rays, samples, seeds, .. } = asked;
    Ok(Study {
        bundle: name,
        renderer,
        frame,
        size,
        samples,
        seeds,
        gather_rays,
        strata_seen: shown.len(),
        levels,
        curves,
    })
}

struct Trials<'a> {
    asked: &'a Asked<'a>,
    seen: &'a Seen,
    interrupt: &'a Interrupt,
}

impl Trials<'_> {
    /// Forecasts of all seeds, in order.
    fn all(
        &self,
        strategy: Strategy,
        records: Records,
        truth: &Truth,
        samples: u32,
    ) -> Result<Vec<Forecast>> {
        let one = |seed: u32| {
            if self.interrupt.is_set() {
                return Err(Interrupted.into());
            }
            trial::forecast(strategy, records, (self.seen, truth), self.asked.size, samples, seed.into())
        };
        self.asked.pool.install(|| (0..self.asked.seeds).into_par_iter().map(one).collect())
    }

    fn at(&self, truth: &Truth, done: &dyn Fn()) -> Result<LevelStudy> {
        let actual = Columns::of(&truth.total());
        let outcome = |strategy, records| -> Result<Outcome> {
            let forecasts = self.all(strategy, records, truth, self.asked.samples)?;
            Ok(Outcome::new(strategy, records, &forecasts, actual))
        };
        let mut outcomes = Vec::with_capacity(Strategy::ALL.len());
        let mut planned = Vec::new();
        for strategy in Strategy::ALL {
            outcomes.push(outcome(strategy, Records::of(strategy))?);
            if truth.level.is_cached() && truth.has_plan() {
                planned.push(outcome(strategy, Records::Planned)?);
            }
            done();
        }
        let Asked { size, samples, .. } = *self.asked;
        let noise_floor = noise::floor(&self.seen.ids, size, &truth.pixels, samples, actual.work);
        Ok(LevelStudy {
            level: truth.level,
            actual,
            noise_floor,
            records: truth.records.clone(),
            outcomes,
            planned,
        })
    }

    fn curve(&self, strategy: Strategy, truth: &Truth) -> Result<Curve> {
        let actual = truth.total().work as f64;
        let pixels = self.seen.ids.len();
        let mut points = Vec::with_capacity(LADDER.len());
        for samples in LADDER.into_iter().filter(|&samples| samples as usize <= pixels) {
            let records = if truth.level.is_cached() { Records::Planned } else { Records::Unknown };
            let forecasts = self.all(strategy, records, truth, samples)?;
            let seconds = forecasts.iter().map(|forecast| forecast.profiling_seconds).sum::<f64>();
            points.push(CurvePoint {
                pixels: forecasts.first().map_or(0, |forecast| forecast.picks),
                cpu_seconds: seconds / forecasts.len().max(1) as f64,
                error: Score::new(forecasts.iter().map(|f| f.mean.work), actual),
            });
        }
        Ok(Curve { level: truth.level, strategy, points })
    }
}
