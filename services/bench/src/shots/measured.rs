use super::practice::Practice;
use crate::statistics::{mean_absolute, relative_error};
use forelight_protocol::{CacheMode, Quantiles, RenderSettings, RenderStats, Spent};
use forelight_renderer_own::Quote;
use serde::Serialize;

#[derive(Debug, Serialize)]
pub struct Measured {
    pub bundle: String,
    pub width: u32,
    pub height: u32,
    pub spp: u32,
    pub ambient_bounces: u32,
    pub cache: CacheMode,
    pub samples: u32,
    pub actual_work: f64,
    /// Measured CPU seconds of all frames.
    pub actual_cpu_seconds: f64,
    /// Mean over all quotes.
    pub forecast: Outcome,
    /// Current practice of farms.
    pub practices: Vec<PracticeOutcome>,
    pub quotes: Vec<Trial>,
    pub frames: Vec<Frame>,
}

impl Measured {
    /// Error of the total, relative to the mean of first, middle and last frame. `None` if that has no error.
    pub fn against_first_middle_last(&self) -> Option<f64> {
        let theirs = self.practices.iter().find(|p| p.practice == Practice::FirstMiddleLast)?.outcome;
        (theirs.total_error > 0.0).then(|| self.forecast.total_error / theirs.total_error)
    }
}

/// Accuracy and cost of one method.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Outcome {
    /// |forecast / actual − 1| of the work of the whole shot; the mean over quotes.
    pub total_error: f64,
    /// Σ |forecast − actual| / Σ actual over the frames' work (weighted absolute percentage error); the mean
    /// over quotes.
    pub wape: f64,
    /// Work of the method, relative to the shot's.
    pub spent: f64,
    /// The part of it that renders cannot reuse.
    pub spent_for_good: f64,
}

#[derive(Debug, Serialize)]
pub struct PracticeOutcome {
    pub practice: Practice,
    #[serde(flatten)]
    pub outcome: Outcome,
}

#[derive(Debug, Serialize)]
pub struct Trial {
    pub seed: u64,
    pub profiled: Vec<u32>,
    pub work: Total,
    pub cpu_seconds: Total,
    pub wape: f64,
    /// Mean over frames of |forecast mean / actual − 1|.
    pub frame_error_work: f64,
    pub frame_error_cpu_seconds: f64,
    /// Share of the frames whose work was at or below the quantile.
    pub frames_within_p80: f64,
    pub frames_within_p95: f64,
    pub spent: Shares,
    pub spent_for_good: Shares,
}

#[derive(Debug, Serialize)]
pub struct Total {
    pub forecast: Quantiles,
    pub actual: f64,
    /// Signed, relative to the actual.
    pub error: f64,
}

impl Total {
    fn new(forecast: Quantiles, actual: f64) -> Self {
        Self { forecast, actual, error: relative_error(forecast.mean, actual) }
    }
}

/// Shares of the actual total.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Shares {
    pub work: f64,
    pub cpu_seconds: f64,
}

#[derive(Debug, Serialize)]
pub struct Frame {
    pub frame: u32,
    pub profiled: bool,
    pub work: Total,
    pub cpu_seconds: Total,
}

/// Compares quotes of a shot, one per seed, with the full render of its frames.
pub fn compare(
    bundle: &str,
    settings: &RenderSettings,
    samples: u32,
    quotes: &[(u64, Quote)],
    actual: &[RenderStats],
) -> Measured {
    let work: Vec<f64> = actual.iter().map(|stats| stats.work as f64).collect();
    let total = work.iter().sum::<f64>();
    let trials: Vec<Trial> = quotes.iter().map(|(seed, quote)| trial(*seed, quote, actual)).collect();
    let mean = |of: &dyn Fn(&Trial) -> f64| trials.iter().map(of).sum::<f64>() / trials.len().max(1) as f64;
    let practices = Practice::ALL.map(|practice| {
        let said = practice.forecast(&work);
        let spent = practice.rendered(work.len()).iter().map(|&t| work[t]).sum::<f64>() / total;
        // This practice renders finished frames, so nothing is lost.
        let outcome = Outcome {
            total_error: relative_error(said.iter().sum(), total).abs(),
            wape: wape(&said, &work),
            spent,
            spent_for_good: 0.0,
        };
        PracticeOutcome { practice, outcome }
    });
    let frames = quotes.first().map(|(_, quote)| frames(quote, actual)).unwrap_or_default();
    Measured {
        bundle: bundle.to_owned(),
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        ambient_bounces: settings.ambient_bounces,
        cache: settings.cache,
        samples,
        actual_work: total,
        actual_cpu_seconds: actual.iter().map(|stats| stats.cpu_seconds).sum(),
        forecast: Outcome {
            total_error: mean(&|trial| trial.work.error.abs()),
            wape: mean(&|trial| trial.wape),
            spent: mean(&|trial| trial.spent.work),
            spent_for_good: mean(&|trial| trial.spent_for_good.work),
        },
        practices: practices.into(),
        quotes: trials,
        frames,
    }
}

fn frames(quote: &Quote, actual: &[RenderStats]) -> Vec<Frame> {
    let document = &quote.document;
    let frame = |(forecast, actual): (&forelight_protocol::FrameForecast, &RenderStats)| Frame {
        frame: actual.frame,
        profiled: document.profiled.frames.contains(&actual.frame),
        work: Total::new(forecast.work, actual.work as f64),
        cpu_seconds: Total::new(forecast.cpu_seconds, actual.cpu_seconds),
    };
    document.frames.iter().zip(actual).map(frame).collect()
}

fn trial(seed: u64, quote: &Quote, actual: &[RenderStats]) -> Trial {
    let document = &quote.document;
    let frames = frames(quote, actual);
    let work: f64 = actual.iter().map(|stats| stats.work as f64).sum();
    let cpu_seconds: f64 = actual.iter().map(|stats| stats.cpu_seconds).sum();
    let shares = |spent: Spent| Shares {
        work: spent.work as f64 / work,
        cpu_seconds: forelight_renderer_own::seconds(spent.cpu_nanos) / cpu_seconds,
    };
    let within = |quantile: fn(&Quantiles) -> f64| {
        let held = frames.iter().filter(|f| f.work.actual <= quantile(&f.work.forecast));
        held.count() as f64 / frames.len().max(1) as f64
    };
    let said: Vec<f64> = frames.iter().map(|frame| frame.work.forecast.mean).collect();
    let is: Vec<f64> = frames.iter().map(|frame| frame.work.actual).collect();
    Trial {
        seed,
        profiled: document.profiled.frames.clone(),
        work: Total::new(document.total.work, work),
        cpu_seconds: Total::new(document.total.cpu_seconds, cpu_seconds),
        wape: wape(&said, &is),
        frame_error_work: mean_absolute(frames.iter().map(|f| f.work.error)),
        frame_error_cpu_seconds: mean_absolute(frames.iter().map(|f| f.cpu_seconds.error)),
        frames_within_p80: within(|q| q.p80),
        frames_within_p95: within(|q| q.p95),
        spent: shares(quote.spent()),
        spent_for_good: shares(quote.spent_for_good()),
    }
}

/// Σ |forecast − actual| / Σ actual. Zero if both are zero.
fn wape(forecast: &[f64], actual: &[f64]) -> f64 {
    let off: f64 = forecast.iter().zip(actual).map(|(forecast, actual)| (forecast - actual).abs()).sum();
    if off == 0.0 { 0.0 } else { off / actual.iter().sum::<f64>() }
}

#[cfg(test)]
mod tests {
    use super::wape;

    #[test]
    fn errors_of_frames_do_not_cancel_in_the_weighted_error() {
        assert_eq!(wape(&[150.0, 50.0], &[100.0, 100.0]), 0.5);
        assert_eq!(wape(&[0.0], &[0.0]), 0.0);
    }
}
