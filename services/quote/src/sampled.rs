//! Quotes of shots that were measured as a few frames at few samples: those of renderers that cannot measure
//! single pixels.

use std::collections::BTreeMap;

use forelight_forecast::{
    Calibration, Corrections, FramePopulation, Measure, Quantity, SampleCost, SampledFrame,
    SampledShotForecast, Strategy, Stratum, forecast_sampled_shot, shot_times, size_power, straightened,
};
use forelight_protocol::{
    FixedCosts, ForecastTotals, FrameForecast, MOST_PARTS, MeasuredFrame, MeasuredShare, PreviewResult,
    Profiled, Quantiles, RayQuantiles, SampleShare, Spent, Varied, at_speed_one,
};

use crate::division::finished_samples;
use crate::error::QuoteError;
use crate::job_forecast::{JobForecast, Quote, Spreads, quantiles};
use crate::populations::Populations;

/// A measured frame, and the speed of the node that measured it.
#[derive(Clone, PartialEq, Debug)]
pub struct SampledProfile {
    /// The measurements.
    pub result: MeasuredFrame,
    /// A CPU second on this node is this many on a node of speed 1.
    pub node_speed: f64,
}

/// Quotes every frame of the preview. CPU time is that of a node of speed 1.
/// The renderer does not count its work, so *work* is CPU time in microseconds. `corrections` from past jobs
/// calibrate the quantiles.
///
/// # Errors
/// If a measured frame is not in the preview, or the statistics refuse the numbers.
pub fn quote_sampled(
    preview: &PreviewResult,
    profiles: &[SampledProfile],
    corrections: Option<&Corrections>,
) -> Result<Quote, QuoteError> {
    let Populations { strata, frames, .. } = Populations::new(preview, [], Strategy::Snapshot, &[]);
    let clock = shot_times(&strata, &frames).map_err(QuoteError::Forecast)?;
    let (shot, _) = forecast(&strata, &frames, profiles)?;
    let shot = match corrections {
        Some(corrections) => shot.corrected(corrections),
        None => shot,
    };
    let spread = |quantity: &Quantity| {
        let spread = quantity.spread(Measure::CpuTime);
        Spreads { work: spread, cpu: spread }
    };
    let spreads = (spread(&shot.total), shot.frames.iter().map(|frame| spread(&frame.cpu_nanos)).collect());
    let frame_forecasts =
        preview.frames.iter().zip(&shot.frames).map(|(previewed, forecast)| FrameForecast {
            frame: previewed.frame,
            rays: RayQuantiles::default(),
            cache_records: Vec::new(),
            work: as_work(&forecast.cpu_nanos),
            cpu_seconds: quantiles(&forecast.cpu_nanos, 1e-9),
        });
    let total = ForecastTotals {
        rays: RayQuantiles::default(),
        cache_records: Vec::new(),
        work: as_work(&shot.total),
        cpu_seconds: quantiles(&shot.total, 1e-9),
    };
    let spent = profiles.iter().map(|profile| profile.result.spent);
    let job = JobForecast {
        profiled: profiled(preview, profiles),
        spent: spent.fold(preview.spent, Spent::plus).on_forecast(total.work.mean),
        total,
        calibrated: shot.calibrated,
        most_parts: most_parts(profiles),
        fixed: Some(fixed(&shot)),
        lights: Populations::lights(&frames),
        clock,
        ..JobForecast::default()
    };
    Ok(Quote { job, frames: frame_forecasts.collect(), spreads, shared_cache: None })
}

/// CPU time in microseconds, from nanoseconds.
fn as_work(cpu_nanos: &Quantity) -> Quantiles {
    quantiles(cpu_nanos, 1e-3)
}

/// The frames that were measured, as the forecast has them.
pub(crate) struct MeasuredCosts {
    /// Index of the frame.
    pub frame: usize,
    costs: Vec<SampleCost>,
    /// Time of each stratum. Empty if the renderer does not say.
    pub times: Vec<f64>,
}

impl MeasuredCosts {
    /// Those of all profiles. CPU time is that of a node of speed 1.
    fn of(
        strata: &[Stratum],
        frames: &[FramePopulation],
        profiles: &[SampledProfile],
    ) -> Result<Vec<Self>, QuoteError> {
        // The background is the last stratum.
        let background = strata.len() - 1;
        let of: BTreeMap<(u32, u32), usize> = strata[..background]
            .iter()
            .enumerate()
            .map(|(at, stratum)| ((stratum.object, stratum.material), at))
            .collect();
        let measured = |SampledProfile { result, node_speed }: &SampledProfile| {
            let number = i64::from(result.frame);
            let frame = frames.iter().position(|frame| frame.number == number);
            let frame = frame.ok_or(QuoteError::NotPreviewed(result.frame))?;
            let cost = |cost: &forelight_protocol::SampleCost| SampleCost {
                samples: cost.amount,
                cpu_nanos: at_speed_one(cost.cpu_nanos, *node_speed),
            };
            let mut times = vec![0.0; strata.len()];
            for time in &result.strata {
                let stratum = stratum_key(time.object, time.material).and_then(|key| of.get(&key).copied());
                times[stratum.unwrap_or(background)] += time.nanos as f64;
            }
            let is_known = times.iter().any(|&time| time > 0.0);
            let times = if is_known { times } else { Vec::new() };
            Ok(Self { frame, costs: result.costs.iter().map(cost).collect(), times })
        };
        profiles.iter().map(measured).collect()
    }
}

/// The forecast of all frames, and the measured ones that it rests on.
pub(crate) fn forecast(
    strata: &[Stratum],
    frames: &[FramePopulation],
    profiles: &[SampledProfile],
) -> Result<(SampledShotForecast, Vec<MeasuredCosts>), QuoteError> {
    let mut inputs = MeasuredCosts::of(strata, frames, profiles)?;
    let whole = profiles.first().map_or(1, |profile| profile.result.whole);
    if let Some(other) = profiles.iter().find(|profile| profile.result.whole != whole) {
        return Err(QuoteError::Measured {
            frame: other.result.frame,
            whole: other.result.whole,
            expected: whole,
        });
    }
    if profiles.iter().all(|profile| profile.result.varied == Varied::Size) {
        let costs: Vec<&[SampleCost]> = inputs.iter().map(|input| input.costs.as_slice()).collect();
        let power = size_power(&costs);
        inputs.iter_mut().for_each(|input| input.costs = straightened(&input.costs, whole, power));
    }
    let sampled: Vec<SampledFrame<'_>> = inputs
        .iter()
        .map(|input| SampledFrame { frame: input.frame, costs: &input.costs, stratum_times: &input.times })
        .collect();
    let shot = forecast_sampled_shot(strata, frames, &sampled, whole, Calibration::NONE);
    Ok((shot.map_err(QuoteError::Forecast)?, inputs))
}

/// Numbers of object and material as a preview has them: 2³² − 2 for what a pixel has none of. `None` for
/// the background, which has neither.
pub fn stratum_key(object: Option<u32>, material: Option<u32>) -> Option<(u32, u32)> {
    const NONE: u32 = u32::MAX - 1;
    (object.is_some() || material.is_some()).then(|| (object.unwrap_or(NONE), material.unwrap_or(NONE)))
}

/// Samples that were measured, as pixels of the image at all its samples.
fn profiled(preview: &PreviewResult, profiles: &[SampledProfile]) -> Profiled {
    let mut frames: Vec<u32> = profiles.iter().map(|profile| profile.result.frame).collect();
    frames.sort_unstable();
    let pixels = preview.frames.first().map_or(0, |frame| {
        frame.pixels.iter().map(|&count| u64::from(count)).sum::<u64>() + u64::from(frame.background)
    });
    Profiled { pixels: pixels * frames.len() as u64, frames }
}

/// A renderer whose renders take over samples can divide a frame by them, after those that are finished.
fn most_parts(profiles: &[SampledProfile]) -> u32 {
    let left = |profile: &SampledProfile| {
        let taken_over: Option<Vec<SampleShare>> =
            profile.result.shares.iter().map(MeasuredShare::taken_over).collect();
        let taken_over =
            taken_over.filter(|shares| !shares.is_empty() && profile.result.varied == Varied::Samples)?;
        Some(profile.result.whole.saturating_sub(finished_samples(&taken_over)))
    };
    let least = profiles.iter().map(left).collect::<Option<Vec<u32>>>().unwrap_or_default();
    least.into_iter().min().unwrap_or(1).clamp(1, MOST_PARTS)
}

/// Mean cost of a frame that does not depend on its samples.
fn fixed(shot: &SampledShotForecast) -> FixedCosts {
    let sum: f64 = shot.frames.iter().map(|frame| frame.fixed_nanos).sum();
    let mean = (sum / shot.frames.len().max(1) as f64).round().max(0.0) as u64;
    FixedCosts { build: Spent::uncounted(mean), ..FixedCosts::default() }
}
