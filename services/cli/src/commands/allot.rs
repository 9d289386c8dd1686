//! `forelight render --within` and `--error`: the camera samples follow from what the frame is to come to.

use crate::failure::BadInput;
use crate::interrupt::Interrupt;
use crate::options::ConfidenceLevel;
use crate::quantities::{count, seconds};
use anyhow::Result;
use forelight_protocol::AllottedStats;
use forelight_worker::{AccuracyObserver, Aim, AllotOptions};
use std::sync::atomic::AtomicBool;

/// What a frame is to come to, in place of a number of camera samples.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Camera samples by what they come to")]
pub struct AllotArgs {
    /// Make the best image that takes this many CPU seconds of all threads, finding out how included: in place of --spp, every object
    /// and the edges of lights get as many camera samples as pay there
    #[arg(long, value_name = "SECONDS", conflicts_with_all = ["spp", "error", "profile"], value_parser = positive)]
    within: Option<f64>,
    /// Make the cheapest image whose noise is at most this share of its mean, in percent (root mean square over the pixels)
    #[arg(long, value_name = "PERCENT", conflicts_with_all = ["spp", "profile"], value_parser = positive)]
    error: Option<f64>,
    /// How sure the seconds or the error are to be kept
    #[arg(long, value_name = "QUANTILE", default_value = "p80")]
    confidence: ConfidenceLevel,
    /// Pixels to profile for it
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    samples: u32,
}

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("a number above 0 is wanted".into()),
    }
}

impl AllotArgs {
    /// What was asked for, if anything was.
    pub fn options(&self) -> Option<AllotOptions> {
        let aim = match (self.within, self.error) {
            (Some(seconds), _) => Aim::CpuSeconds(seconds),
            (None, Some(percent)) => Aim::Error(percent / 100.0),
            (None, None) => return None,
        };
        Some(AllotOptions { aim, confidence: self.confidence.into(), samples: self.samples, seed: 0 })
    }
}

/// The user's wish to stop.
pub struct Stopping<'a>(pub &'a Interrupt);

impl AccuracyObserver for Stopping<'_> {
    fn predicted(&self, _: usize, _: usize) {}

    fn cancel(&self) -> &AtomicBool {
        self.0.flag()
    }
}

/// A time too short is the user's to mend.
pub fn failure(error: forelight_worker::AllotError) -> anyhow::Error {
    match error {
        forelight_worker::AllotError::TooLittle { .. } => {
            BadInput::new(format!("--within: {error}; give it more, or ask for a smaller image")).into()
        }
        forelight_worker::AllotError::Shot(forelight_worker::ShotError::Render(error)) => error.into(),
        error => error.into(),
    }
}

/// Lines of the report.
pub fn report(allotted: &AllottedStats) -> String {
    let AllottedStats { least, most, mean, work, cpu_seconds, error, .. } = allotted;
    format!(
        "allotted    {least} to {most} camera samples per pixel, {mean:.1} on average\n\
         forecast    {} operations, {} CPU time (at 95 % {}), noise {:.2} % of the mean (at 95 % {:.2} %)\n\
         profiled    {} of CPU time to find that out\n",
        count(work.mean),
        seconds(cpu_seconds.mean),
        seconds(cpu_seconds.p95),
        100.0 * error.p50,
        100.0 * error.p95,
        seconds(allotted.profiling_cpu_seconds),
    )
}
