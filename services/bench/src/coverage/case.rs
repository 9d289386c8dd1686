//! Forecasts one shot whose true cost per pixel is known, and compares the two.

use anyhow::Result;
use forelight_forecast::{
    Calibration, Cost, Expansion, FrameDesign, FramePopulation, Measure, Observation, Pick, PixelCosts,
    ProfiledFrame, Quantity, Stratum, StratumEstimate, choose_frames, estimate, forecast_shot, residual,
};

/// Quantiles in the diagram. They include those that quotes name.
pub const NOMINAL: [f64; 13] = [0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98];

/// A shot with the true cost of every pixel.
pub struct Known {
    pub strata: Vec<Stratum>,
    /// Width of a frame, pixels.
    pub width: u32,
    pub frames: Vec<KnownFrame>,
}

pub struct KnownFrame {
    pub number: i64,
    pub ids: Vec<u32>,
    pub costs: Vec<Cost>,
    /// Fixed cost. A forecast knows it once the frame is profiled.
    pub fixed: Cost,
}

/// A forecast of work, and the truth.
#[derive(Debug, Clone, Copy)]
pub struct Judged {
    /// The forecast, not calibrated.
    pub forecast: Quantity,
    pub actual: f64,
}

impl Judged {
    /// Error in units of the forecast's spread. `None` if nothing has a cost.
    pub fn residual(&self) -> Option<f64> {
        residual(self.forecast.mean, self.forecast.spread(Measure::Work), self.actual)
    }
}

/// Pixels, and how many of them cost at most the quantile.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    /// All pixels that were not profiled.
    pub pixels: u64,
    /// Pixels that have a forecast, by quantile in [`NOMINAL`].
    pub promised: [u64; NOMINAL.len()],
    /// Pixels at or below the forecast.
    pub held: [u64; NOMINAL.len()],
}

/// All forecasts of one quote.
#[derive(Debug, Clone, Default)]
pub struct Case {
    /// Unprofiled pixels of profiled frames.
    pub pixels: Tally,
    /// Strata of profiled frames with at least two profiled pixels and some unprofiled ones.
    pub strata: Vec<Judged>,
    pub frames: Vec<Judged>,
    pub shot: Vec<Judged>,
}

/// Size of a quote.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    pub frames: usize,
    /// Pixels to profile in each frame.
    pub samples: u32,
}

impl Known {
    /// Makes a quote as the farm does, and compares it with the truth.
    pub fn judge(&self, effort: Effort, seed: u64) -> Result<Case> {
        let populations: Vec<FramePopulation> = self
            .frames
            .iter()
            .map(|frame| FramePopulation {
                number: frame.number,
                counts: self.counts(frame),
                lights: 0,
                shining: 0,
                triangles: 0,
            })
            .collect();
        let chosen = choose_frames(&self.strata, &populations, effort.frames)?;
        let mut case = Case::default();
        let mut observed = Vec::with_capacity(chosen.len());
        let mut picks = Vec::with_capacity(chosen.len());
        for &t in &chosen {
            let frame = &self.frames[t];
            let design =
                FrameDesign::new(&self.strata, &frame.ids, self.width, effort.samples, seed, frame.number)?;
            let observe = |picks: &[Pick]| -> Vec<Observation> {
                let cost = |pixel: u32| frame.costs[pixel as usize];
                picks.iter().map(|p| Observation { stratum: p.stratum, cost: cost(p.pixel) }).collect()
            };
            let mut chosen = design.first_phase();
            let mut observations = observe(&chosen);
            let second = design.second_phase(&observations)?;
            observations.extend(observe(&second));
            chosen.extend(second);
            case.strata.extend(self.judge_strata(frame, &populations[t].counts, &observations)?);
            observed.push(observations);
            picks.push(chosen);
        }
        let profiled: Vec<ProfiledFrame<'_>> = chosen
            .iter()
            .zip(&observed)
            .map(|(&frame, observations)| ProfiledFrame {
                frame,
                observations,
                expansion: &Expansion::Groups,
                fixed: self.frames[frame].fixed,
                build: Cost::default(),
            })
            .collect();
        let found = forecast_shot(&self.strata, &populations, &profiled, Calibration::NONE)?;
        for (&t, (observations, picks)) in chosen.iter().zip(observed.iter().zip(&picks)) {
            let costs = PixelCosts::new(&self.strata, &populations[t].counts, observations);
            self.frames[t].judge_pixels(&found.frames[t].strata, &costs, picks, &mut case.pixels);
        }
        let actual: Vec<f64> = self.frames.iter().map(KnownFrame::work).collect();
        let judged = |(frame, &actual): (&forelight_forecast::FrameForecast, &f64)| Judged {
            forecast: frame.total.work,
            actual,
        };
        case.frames = found.frames.iter().zip(&actual).map(judged).collect();
        case.shot = vec![Judged { forecast: found.total.work, actual: actual.iter().sum() }];
        Ok(case)
    }

    fn counts(&self, frame: &KnownFrame) -> Vec<u32> {
        let mut counts = vec![0; self.strata.len()];
        frame.ids.iter().for_each(|&id| counts[id as usize] += 1);
        counts
    }

    /// Judges each stratum as if it were the whole frame.
    fn judge_strata(
        &self,
        frame: &KnownFrame,
        counts: &[u32],
        observations: &[Observation],
    ) -> Result<Vec<Judged>> {
        let mut judged = Vec::new();
        for (h, (&stratum, &pixels)) in (0u32..).zip(self.strata.iter().zip(counts)) {
            let own: Vec<Observation> = observations
                .iter()
                .filter(|observation| observation.stratum == h)
                .map(|observation| Observation { stratum: 0, ..*observation })
                .collect();
            if own.len() < 2 || own.len() as u64 >= u64::from(pixels) {
                continue;
            }
            let forecast = estimate(&[stratum], &[pixels], &own, Calibration::NONE)?.total.work;
            let costs = frame.ids.iter().zip(&frame.costs).filter(|(id, _)| **id == h);
            judged.push(Judged { forecast, actual: costs.map(|(_, cost)| cost.work as f64).sum() });
        }
        Ok(judged)
    }
}

impl KnownFrame {
    fn judge_pixels(
        &self,
        strata: &[StratumEstimate],
        costs: &PixelCosts,
        picks: &[Pick],
        tally: &mut Tally,
    ) {
        let quantiles = NOMINAL.map(|p| costs.at(p));
        let promised = |(h, known): (usize, &StratumEstimate)| {
            let mean = known.mean.work;
            quantiles.each_ref().map(|quantile| quantile.of(h, mean, mean))
        };
        let promised: Vec<[Option<f64>; NOMINAL.len()]> = strata.iter().enumerate().map(promised).collect();
        let mut profiled = vec![false; self.ids.len()];
        picks.iter().for_each(|pick| profiled[pick.pixel as usize] = true);
        for ((&id, cost), _) in self.ids.iter().zip(&self.costs).zip(profiled).filter(|(_, known)| !known) {
            tally.pixels += 1;
            for (place, most) in promised[id as usize].into_iter().enumerate() {
                let Some(most) = most else { continue };
                tally.promised[place] += 1;
                // The factor allows for rounding of equal means.
                tally.held[place] += u64::from(cost.work as f64 <= most * (1.0 + 1e-9));
            }
        }
    }

    fn work(&self) -> f64 {
        self.costs.iter().chain([&self.fixed]).map(|cost| cost.work as f64).sum()
    }
}
