//! Forecasts all frames of a shot from the profiled ones.

use std::collections::BTreeMap;

use forelight_forecast::{
    Calibration, Cost, Costs, FramePopulation, Observation, ProfiledFrame, RecordStrata, ShotForecast,
    Stratum, forecast_shot, with_times,
};
use forelight_protocol::{
    CacheSample, FixedCosts, PlanCount, ProfileResult, ProfileSample, SharedSample, Spent, at_speed_one,
};

use crate::error::QuoteError;
use crate::measured::{Measured, MeasuredProfile, SharedCache};
use crate::populations::Populations;

/// Forecasts of a shot. The quantiles are not corrected by past jobs.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Forecasts of each frame and of all frames together. CPU time is that of a node of speed 1.
    pub shot: ShotForecast,
    pub(crate) populations: Populations,
    /// Stratum of each profiled pixel, by profile.
    pub(crate) sampled: Vec<Vec<u32>>,
}

/// A profiled frame, as input of the statistics.
struct Observed {
    frame: usize,
    observations: Vec<Observation>,
    /// Fixed costs, except for the build.
    fixed: Cost,
    build: Cost,
    /// Pixels and records of the frame by stratum, before [`make_room`] changed them.
    counts: Vec<u32>,
}

impl Measured<'_> {
    /// Estimates every frame. With a shared cache, each frame pays only for the records that it gathers
    /// itself.
    ///
    /// # Errors
    /// If a profile's frame is not in the preview, or the statistics refuse the numbers.
    pub fn estimate(&self) -> Result<Estimate, QuoteError> {
        let strata = self.profiles.iter().flat_map(|profile| &profile.result.strata);
        let gathered: Vec<&[u32]> = self.records().into_iter().map(|(_, own)| own).collect();
        let mut populations = Populations::new(self.preview, strata, self.strategy, &gathered);
        let mut plans = self.plans();
        // Old previews lack the cost of planning a cache. It is then estimated from the profiled frames.
        let plans_are_known = !plans.is_empty();
        let own = OwnRecords::of(self.profiles);
        let mut observed = Vec::with_capacity(self.profiles.len());
        for profile in self.profiles {
            let frame = self.observe(profile, &mut populations, &own, plans_are_known)?;
            if self.shared.is_some()
                && let Some(plan) = plans.get_mut(frame.frame)
            {
                let surplus = surplus(&frame.counts, &frame.observations, &populations.strata);
                *plan = plan.plus(&surplus.times(-1.0));
            }
            observed.push(frame);
        }
        let profiled: Vec<ProfiledFrame<'_>> = observed
            .iter()
            .zip(self.profiles)
            .map(|(frame, profile)| ProfiledFrame {
                frame: frame.frame,
                observations: &frame.observations,
                expansion: &profile.expansion,
                fixed: frame.fixed,
                build: frame.build,
            })
            .collect();
        let mut shot = forecast_shot(&populations.strata, &populations.frames, &profiled, Calibration::NONE)
            .map_err(QuoteError::Forecast)?
            .with_known(&plans, Calibration::NONE);
        // Show the records that a frame gathers beside the shared cache.
        for frame in observed.iter().filter(|_| self.shared.is_some()) {
            let strata = shot.frames[frame.frame].strata.iter_mut();
            for ((sum, stratum), &count) in strata.zip(&populations.strata).zip(&frame.counts) {
                if stratum.apart {
                    sum.pixels = count;
                }
            }
        }
        let pixels = |(profile, frame): (&MeasuredProfile, &Observed)| {
            let pixels = frame.observations.iter().take(profile.result.samples.len());
            pixels.map(|observation| observation.stratum).collect()
        };
        let sampled = self.profiles.iter().zip(&observed).map(pixels).collect();
        Ok(Estimate { shot, populations, sampled })
    }

    /// Reads one profile, and calls [`make_room`] for its observations.
    fn observe(
        &self,
        profile: &MeasuredProfile,
        populations: &mut Populations,
        own: &OwnRecords,
        plans_are_known: bool,
    ) -> Result<Observed, QuoteError> {
        let MeasuredProfile { result, node_speed, .. } = profile;
        let frame = self.preview.frames.iter().position(|frame| frame.frame == result.frame);
        let frame = frame.ok_or(QuoteError::NotPreviewed(result.frame))?;
        let cost = |Spent { work, cpu_nanos }: Spent, rays: [u64; 7]| {
            let cpu_nanos = at_speed_one(cpu_nanos, *node_speed);
            Cost { work, cpu_nanos, rays }
        };
        let pixels = result.samples.iter().zip(0..).map(|(sample, place)| {
            let (spent, rays) = self.pixel_cost(result, sample, place);
            Observation { stratum: populations.stratum_of(sample, result), cost: cost(spent, rays) }
        });
        let records = match self.shared {
            Some(_) => &result.shared_cache_samples,
            None => &result.cache_samples,
        };
        let records = records.iter().filter(|sample| self.shared.is_none() || own.contains(sample));
        let records = records.map(|sample| {
            let spent = Spent { work: sample.work, cpu_nanos: sample.cpu_nanos };
            populations.records.observation(sample.level, cost(spent, sample.rays))
        });
        let observations: Vec<Observation> = pixels.chain(records).collect();
        let counts = populations.frames[frame].counts.clone();
        make_room(&mut populations.frames[frame].counts, &observations);
        let fixed = if plans_are_known { result.fixed.without_plan() } else { result.fixed };
        Ok(Observed {
            frame,
            observations,
            fixed: cost(fixed.without_build(), fixed.plan_rays),
            build: cost(fixed.build, [0; 7]),
            counts,
        })
    }

    /// Cost of a profiled pixel, with the shared cache if there is one.
    fn pixel_cost(&self, profile: &ProfileResult, sample: &ProfileSample, place: usize) -> (Spent, [u64; 7]) {
        match profile.shared_samples.get(place).filter(|_| self.shared.is_some()) {
            Some(&SharedSample { work, cpu_nanos, rays, .. }) => (Spent { work, cpu_nanos }, rays),
            None => (Spent { work: sample.work, cpu_nanos: sample.cpu_nanos }, sample.rays),
        }
    }

    /// Cost of planning each frame's irradiance cache. Empty if the preview does not know it.
    fn plans(&self) -> Vec<Costs<f64>> {
        match self.shared {
            Some(shared) => {
                let frames = shared.plan.frames.iter();
                frames
                    .map(|frame| {
                        let Spent { work, cpu_nanos } = frame.plan;
                        let cpu_nanos = at_speed_one(cpu_nanos, shared.node_speed);
                        Costs::from(Cost { work, cpu_nanos, rays: frame.plan_rays })
                    })
                    .collect()
            }
            None => {
                let frames = self.preview.frames.iter();
                let counted: Option<Vec<PlanCount>> = frames.map(|frame| frame.cache_plan).collect();
                let counted = counted.unwrap_or_default().into_iter();
                // Seconds per operation are those of the plans of the profiled frames.
                let timed = self.profiles.iter().map(|profile| {
                    let plan = profile.result.fixed.at_speed_one(profile.node_speed).plan;
                    (plan.work, plan.cpu_nanos)
                });
                let cost = |PlanCount { work, rays }| Cost { work, rays, ..Cost::default() };
                with_times(counted.map(cost), timed)
            }
        }
    }

    /// Fixed costs of a frame: the mean of the profiled frames. With a shared cache, the preview knows the
    /// planning cost of each frame. It is that of `frame`, or the mean of all.
    pub(crate) fn fixed_costs(&self, frame: Option<u32>) -> Option<FixedCosts> {
        let fixed = |profile: &MeasuredProfile| profile.result.fixed.at_speed_one(profile.node_speed);
        let own = FixedCosts::mean(&self.profiles.iter().map(fixed).collect::<Vec<_>>())?;
        let Some(SharedCache { plan: shared, node_speed }) = self.shared else { return Some(own) };
        let frames =
            shared.frames.iter().filter(|planned| frame.is_none_or(|number| planned.frame == number));
        let plans = frames.map(|planned| {
            let plan =
                FixedCosts { plan: planned.plan, plan_rays: planned.plan_rays, ..FixedCosts::default() };
            plan.at_speed_one(node_speed)
        });
        let FixedCosts { plan, plan_rays, .. } =
            FixedCosts::mean(&plans.collect::<Vec<_>>()).unwrap_or_default();
        Some(FixedCosts { plan, plan_rays, ..own })
    }
}

/// Chooses the sampled records that represent those which frames gather beside a shared cache.
struct OwnRecords {
    /// Number of the frames' own records that were sampled, by level.
    sampled: BTreeMap<u32, usize>,
}

impl OwnRecords {
    /// With fewer own samples of a level, all of its records are used.
    const LEAST: usize = 4;

    fn of(profiles: &[MeasuredProfile]) -> Self {
        let mut sampled = BTreeMap::new();
        let samples = profiles.iter().flat_map(|profile| &profile.result.shared_cache_samples);
        samples.filter(|sample| sample.own).for_each(|sample| *sampled.entry(sample.level).or_default() += 1);
        Self { sampled }
    }

    fn contains(&self, sample: &CacheSample) -> bool {
        sample.own || self.sampled.get(&sample.level).is_none_or(|&own| own < Self::LEAST)
    }
}

/// Raises counts to the number of samples of a stratum.
///
/// Hazard: where a GPU previews a frame and a CPU profiles it, pixels at edges may show other objects. A
/// stratum may then have more profiled pixels than counted ones, which the forecast refuses. The traced
/// pixels are right, so the count is raised.
pub(crate) fn make_room(counts: &mut [u32], observations: &[Observation]) {
    let mut samples = vec![0u32; counts.len()];
    for observation in observations {
        if let Some(samples) = samples.get_mut(observation.stratum as usize) {
            *samples += 1;
        }
    }
    for (count, samples) in counts.iter_mut().zip(samples) {
        *count = (*count).max(samples);
    }
}

/// Cost of records that were measured beyond those that the frame gathers. [`make_room`] adds them to a
/// forecast; this amount takes them off again.
pub(crate) fn surplus(counts: &[u32], observations: &[Observation], strata: &[Stratum]) -> Costs<f64> {
    let mut all = Costs::<f64>::default();
    for (_, place) in strata.iter().zip(0..).filter(|(stratum, _)| stratum.apart) {
        let of_stratum: Vec<&Observation> =
            observations.iter().filter(|observation| observation.stratum == place).collect();
        let gathered = counts.get(place as usize).map_or(0, |&count| count as usize);
        if of_stratum.len() > gathered {
            let measured = of_stratum
                .iter()
                .fold(Costs::<f64>::default(), |sum, observation| sum.plus(&Costs::from(observation.cost)));
            let share = (of_stratum.len() - gathered) as f64 / of_stratum.len() as f64;
            all = all.plus(&measured.times(share));
        }
    }
    all
}

/// A frame with these records and no pixels, and the stratum of each level.
pub(crate) fn records_alone(
    background: f64,
    prior_cost: f64,
    records: &[u32],
) -> (Vec<Stratum>, Vec<FramePopulation>, RecordStrata) {
    let mut strata = vec![Stratum::background(background)];
    let mut frames =
        vec![FramePopulation { number: 0, counts: vec![0], lights: 0, shining: 0, triangles: 0 }];
    let places = RecordStrata::add(&mut strata, &mut frames, &[records], prior_cost);
    (strata, frames, places)
}
