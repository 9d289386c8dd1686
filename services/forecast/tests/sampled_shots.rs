//! Forecasts from few samples of few frames, against made-up shots whose costs are known.

mod common;

use common::Stream;
use forelight_forecast::{
    Calibration, ForecastError, FramePopulation, SampleCost, SampledFrame, SampledShotForecast, Stratum,
    forecast_sampled_shot,
};

/// Samples of the frames whose cost is asked for.
const SAMPLES: u32 = 64;

/// A shot of two strata. The second one is dear, and its share of the picture changes over time.
struct Shot {
    strata: [Stratum; 2],
    frames: Vec<FramePopulation>,
    /// Cost of a sample of a pixel of each stratum, nanoseconds.
    units: [f64; 2],
    fixed: f64,
}

impl Shot {
    fn new(length: i64, dear_share: impl Fn(f64) -> f64) -> Self {
        let strata = [0, 1].map(|i| Stratum { object: i, material: i, prior_cost: 1.0, apart: false });
        let frames = (0..length).map(|number| {
            let dear = (10_000.0 * dear_share(number as f64 / (length - 1) as f64)).round() as u32;
            let counts = vec![10_000 - dear, dear];
            FramePopulation { number, counts, lights: 0, shining: 1, triangles: 1000 }
        });
        Self { strata, frames: frames.collect(), units: [1000.0, 6000.0], fixed: 2e8 }
    }

    fn per_sample(&self, frame: usize) -> f64 {
        let counts = &self.frames[frame].counts;
        f64::from(counts[0]) * self.units[0] + f64::from(counts[1]) * self.units[1]
    }

    fn cost(&self, frame: usize, samples: u32) -> f64 {
        self.fixed + f64::from(samples) * self.per_sample(frame)
    }

    fn total(&self) -> f64 {
        (0..self.frames.len()).map(|t| self.cost(t, SAMPLES)).sum()
    }

    /// Measures frames at these numbers of samples, with relative noise.
    fn forecast(
        &self,
        measured: &[usize],
        samples: &[u32],
        with_times: bool,
        mut noise: impl FnMut() -> f64,
    ) -> SampledShotForecast {
        let costs: Vec<Vec<SampleCost>> = measured
            .iter()
            .map(|&t| {
                let cost = |&samples: &u32| {
                    let cpu_nanos = (self.cost(t, samples) * (1.0 + noise())) as u64;
                    SampleCost { samples, cpu_nanos }
                };
                samples.iter().map(cost).collect()
            })
            .collect();
        let times: Vec<Vec<f64>> = measured
            .iter()
            .map(|&t| {
                let counts = &self.frames[t].counts;
                (0..2).map(|h| f64::from(counts[h]) * self.units[h]).collect()
            })
            .collect();
        let frames: Vec<SampledFrame<'_>> = measured
            .iter()
            .zip(&costs)
            .zip(&times)
            .map(|((&frame, costs), times)| SampledFrame {
                frame,
                costs,
                stratum_times: if with_times { times } else { &[] },
            })
            .collect();
        forecast_sampled_shot(&self.strata, &self.frames, &frames, SAMPLES, Calibration::NONE).unwrap()
    }
}

fn bump(x: f64) -> f64 {
    0.1 + 0.5 * (-((x - 0.55) / 0.12).powi(2)).exp()
}

#[test]
fn costs_that_counts_explain_are_carried_by_counts() {
    let shot = Shot::new(48, bump);
    let measured = [0, 12, 24, 36, 47];
    let by_counts = shot.forecast(&measured, &[1, 8], true, || 0.0);
    assert!(by_counts.by_counts);
    assert!((by_counts.total.mean / shot.total() - 1.0).abs() < 1e-6);
    let by_time = shot.forecast(&measured, &[1, 8], false, || 0.0);
    assert!(!by_time.by_counts);
    assert!((by_time.total.mean / shot.total() - 1.0).abs() > 0.01);
    assert!(by_time.total.p95 > by_counts.total.p95);
    for (t, frame) in by_counts.frames.iter().enumerate() {
        assert!((frame.cpu_nanos.mean / shot.cost(t, SAMPLES) - 1.0).abs() < 1e-6);
        assert_eq!(frame.measured, measured.contains(&t));
        assert!((frame.fixed_nanos / shot.fixed - 1.0).abs() < 1e-6);
    }
}

#[test]
fn quantiles_cover_what_comes() {
    let shots = [Shot::new(48, bump), Shot::new(48, |x| 0.2 + 0.3 * x), Shot::new(96, |_| 0.3)];
    for (name, samples) in [("two measurements", &[1, 8][..]), ("with spare ones", &[1, 4, 4, 8])] {
        let (mut in_80, mut in_95, mut all) = (0.0, 0.0, 0.0);
        for seed in 0..300 {
            let mut random = Stream::new(seed);
            let shot = &shots[seed as usize % shots.len()];
            let last = shot.frames.len() - 1;
            let measured = [0, last / 4, last / 2, 3 * last / 4, last];
            let found = shot.forecast(&measured, samples, true, || 0.03 * random.normal());
            in_80 += f64::from(u8::from(shot.total() <= found.total.p80));
            in_95 += f64::from(u8::from(shot.total() <= found.total.p95));
            all += 1.0;
        }
        println!("{name}: P80 holds {:.3}, P95 {:.3}", in_80 / all, in_95 / all);
        assert!(in_80 / all >= 0.77 && in_95 / all >= 0.92, "{name}: {in_80} and {in_95} of {all}");
    }
}

#[test]
fn noise_is_measured_where_frames_have_spare_measurements() {
    let shot = Shot::new(24, |_| 0.3);
    let mut random = Stream::new(5);
    let quiet = shot.forecast(&[0, 12, 23], &[1, 2, 4, 8, 8, 8], true, || 0.002 * random.normal());
    let loud = shot.forecast(&[0, 12, 23], &[1, 2, 4, 8, 8, 8], true, || 0.12 * random.normal());
    assert!(quiet.noise < 0.02 && loud.noise > 0.05, "{} and {}", quiet.noise, loud.noise);
    assert_eq!(quiet.spare_measurements, 12);
    assert!(loud.job_sigma > quiet.job_sigma);
}

#[test]
fn a_single_frame_is_a_shot() {
    let shot = Shot { frames: Shot::new(2, |_| 0.3).frames[..1].to_vec(), ..Shot::new(2, |_| 0.3) };
    let found = shot.forecast(&[0], &[1, 8], true, || 0.0);
    assert!((found.total.mean / shot.total() - 1.0).abs() < 1e-6);
    assert!(found.total.p95 > found.total.p80 && found.total.p80 > found.total.p50);
}

#[test]
fn what_cannot_be_forecast_is_said() {
    let shot = Shot::new(4, |_| 0.3);
    let ask = |measured: &[SampledFrame<'_>]| {
        forecast_sampled_shot(&shot.strata, &shot.frames, measured, SAMPLES, Calibration::NONE).unwrap_err()
    };
    assert_eq!(ask(&[]), ForecastError::NoSamples);
    let one = [SampleCost { samples: 4, cpu_nanos: 10 }];
    let frame = SampledFrame { frame: 2, costs: &one, stratum_times: &[] };
    assert_eq!(ask(&[frame]), ForecastError::NoSampleLine { frame: 2 });
    let beyond = SampledFrame { frame: 9, ..frame };
    assert_eq!(ask(&[beyond]), ForecastError::ProfiledFrame { index: 9 });
}
