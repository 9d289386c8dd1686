//! Makes forecasts from known pixel costs, and scores them.

use super::level::{Seen, Truth};
use crate::statistics::{mean_absolute, relative_error};
use anyhow::Result;
use forelight_forecast::{
    Calibration, Cost, Costs, FramePopulation, ProfiledFrame, Quantity, RecordStrata, Strategy, forecast_shot,
};
use serde::Serialize;

/// A value for each of the three columns of the tables.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Columns<T> {
    pub rays: T,
    pub work: T,
    pub cpu_seconds: T,
}

impl<T: Copy> Columns<T> {
    pub fn map<U>(self, mut f: impl FnMut(T) -> U) -> Columns<U> {
        Columns { rays: f(self.rays), work: f(self.work), cpu_seconds: f(self.cpu_seconds) }
    }
}

impl Columns<f64> {
    pub fn of(cost: &Cost) -> Self {
        Self {
            rays: cost.rays.iter().sum::<u64>() as f64,
            work: cost.work as f64,
            cpu_seconds: cost.cpu_nanos as f64 * 1e-9,
        }
    }
}

impl Columns<Quantity> {
    fn of(costs: &Costs<Quantity>) -> Self {
        Self { rays: costs.all_rays, work: costs.work, cpu_seconds: costs.cpu_nanos }
    }
}

/// How a strategy treats an irradiance cache. Without one, both are the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Records {
    /// As in the paper: profiled pixels meet an empty cache and are expanded as they are.
    Unknown,
    /// The number of records is known, some are gathered, and pixels only read.
    Planned,
}

impl Records {
    /// Default of a strategy: ours plan, the paper's do not.
    pub fn of(strategy: Strategy) -> Self {
        match strategy {
            Strategy::Systematic | Strategy::Snapshot => Records::Planned,
            _ => Records::Unknown,
        }
    }
}

/// A forecast of the frame's total.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forecast {
    /// Means. CPU time is in seconds.
    pub mean: Columns<f64>,
    /// Forecast of work, with its variance.
    pub work: Quantity,
    /// Number of profiled pixels.
    pub picks: usize,
    /// CPU seconds of these pixels and of the gathered records.
    pub profiling_seconds: f64,
}

/// Forecasts the frame at one level from `samples` pixels.
pub fn forecast(
    strategy: Strategy,
    records: Records,
    (seen, truth): (&Seen, &Truth),
    width: u32,
    samples: u32,
    seed: u64,
) -> Result<Forecast> {
    let design = strategy.design(&seen.strata, &seen.ids, width, samples, seed, 0)?;
    let planned = records == Records::Planned && truth.has_plan();
    let costs = if planned { &truth.pixels } else { &truth.cold };
    let (picks, mut observations) = design.profile(|pixel| costs[pixel as usize])?;
    let mut strata = design.strata().to_vec();
    let mut frames = [FramePopulation {
        number: 0,
        counts: design.counts().to_vec(),
        lights: 0,
        shining: 0,
        triangles: 0,
    }];
    if planned {
        let prior = truth.record_prior_cost;
        let apart = RecordStrata::add(&mut strata, &mut frames, &[&truth.records], prior);
        let sampled = truth.sampled(samples).get(seed as usize).into_iter().flatten();
        observations.extend(sampled.map(|&(level, cost)| apart.observation(level, cost)));
    }
    let fixed = if planned { truth.plan } else { Cost::default() };
    let expansion = design.expansion();
    let profiled =
        [ProfiledFrame { frame: 0, observations: &observations, expansion, fixed, build: Cost::default() }];
    let found = forecast_shot(&strata, &frames, &profiled, Calibration::NONE)?.total;
    let mut mean = Columns::<Quantity>::of(&found).map(|quantity| quantity.mean);
    mean.cpu_seconds *= 1e-9;
    let profiling = observations.iter().map(|observation| observation.cost.cpu_nanos).sum::<u64>();
    Ok(Forecast { mean, work: found.work, picks: picks.len(), profiling_seconds: profiling as f64 * 1e-9 })
}

/// Relative errors over many seeds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Score {
    /// Mean of |forecast / actual − 1|.
    pub mean_absolute: f64,
    /// Standard deviation over the seeds.
    pub deviation: f64,
    /// Mean of forecast / actual − 1.
    pub bias: f64,
    /// Deviation and bias together.
    pub root_mean_square: f64,
    /// Largest |forecast / actual − 1|.
    pub largest: f64,
}

impl Score {
    pub fn new(forecasts: impl Iterator<Item = f64>, actual: f64) -> Self {
        let errors: Vec<f64> = forecasts.map(|forecast| relative_error(forecast, actual)).collect();
        let count = errors.len().max(1) as f64;
        let bias = errors.iter().sum::<f64>() / count;
        let squares = errors.iter().map(|error| error * error).sum::<f64>() / count;
        let apart = errors.iter().map(|error| (error - bias) * (error - bias)).sum::<f64>();
        Self {
            mean_absolute: mean_absolute(errors.iter().copied()),
            deviation: (apart / (count - 1.0).max(1.0)).sqrt(),
            bias,
            root_mean_square: squares.sqrt(),
            largest: errors.iter().fold(0.0, |most, error| error.abs().max(most)),
        }
    }
}

/// Results of a strategy at one level.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    pub strategy: Strategy,
    /// What it knows of the cache's records.
    pub records: Records,
    /// Number of profiled pixels.
    pub samples: usize,
    /// Forecast with seed 0: one run, as in the paper.
    pub one_run: Columns<f64>,
    pub error: Columns<Score>,
    /// Estimated standard deviation of work over the observed one (root mean square error). `None` if the
    /// strategy estimates no variance.
    pub estimated_over_seen: Option<f64>,
    /// Share of the seeds whose work was at or below P80 and P95. `None` for the paper's strategies.
    pub covered: Option<[f64; 2]>,
}

impl Outcome {
    /// Scores the forecasts of all seeds. There must be at least one.
    pub fn new(strategy: Strategy, records: Records, forecasts: &[Forecast], actual: Columns<f64>) -> Self {
        let score = |column: fn(&Columns<f64>) -> f64| {
            Score::new(forecasts.iter().map(|forecast| column(&forecast.mean)), column(&actual))
        };
        let error = Columns {
            rays: score(|c| c.rays),
            work: score(|c| c.work),
            cpu_seconds: score(|c| c.cpu_seconds),
        };
        let count = forecasts.len().max(1) as f64;
        let variance = forecasts.iter().map(|forecast| forecast.work.variance).sum::<f64>() / count;
        let seen = error.work.root_mean_square * actual.work;
        let covered = |quantile: fn(&Quantity) -> f64| {
            let held = forecasts.iter().filter(|forecast| actual.work <= quantile(&forecast.work));
            held.count() as f64 / count
        };
        Self {
            strategy,
            records,
            samples: forecasts.first().map_or(0, |forecast| forecast.picks),
            one_run: forecasts.first().map_or(Columns::default(), |forecast| forecast.mean),
            error,
            estimated_over_seen: (strategy.knows_its_variance() && seen > 0.0)
                .then(|| variance.sqrt() / seen),
            covered: (strategy == Strategy::Snapshot).then(|| [covered(|q| q.p80), covered(|q| q.p95)]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_score_has_luck_and_bias_apart() {
        let score = Score::new([110.0, 130.0].into_iter(), 100.0);
        assert!((score.bias - 0.2).abs() < 1e-12 && (score.mean_absolute - 0.2).abs() < 1e-12);
        assert!((score.deviation - 0.02f64.sqrt()).abs() < 1e-12);
        assert!((score.root_mean_square - 0.05f64.sqrt()).abs() < 1e-12);
        assert!((score.largest - 0.3).abs() < 1e-12);
        assert_eq!(Score::new([5.0].into_iter(), 5.0), Score::default());
    }
}
