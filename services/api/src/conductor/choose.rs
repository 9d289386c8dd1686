//! From a preview to the frames that are worth profiling.

use std::collections::BTreeMap;

use forelight_forecast::{
    FIRST_FRAMES, ForecastError, FramePopulation, RecordStrata, Stratum, choose_frames, choose_more_frames,
};
use forelight_protocol::{self as protocol, PreviewResult, StratumName};
use forelight_store::MeasuredProfile;

use super::AdvanceError;
use super::estimate::{Estimated, estimated};

/// A preview as the forecast wants it: strata by number, the background as the last of those of pixels, then those of the
/// irradiance cache's records.
///
/// The worker that profiled joined small strata by material, pixel counts and prior costs; an estimate that joined them in
/// another way would be biased. So objects, materials and prior costs are the workers' own, and the strata are in their order.
pub(super) struct Populations {
    pub strata: Vec<Stratum>,
    pub frames: Vec<FramePopulation>,
    /// What people call the strata, the background and the records excepted.
    pub names: Vec<StratumName>,
    /// Place of each stratum, by object and material.
    pub index: BTreeMap<(u32, u32), usize>,
    /// The number of the background's stratum.
    pub background: usize,
    /// Where the records are.
    pub records: RecordStrata,
}

impl Populations {
    /// The strata of a preview and then those of `more` that it does not have: a profile made on another kind of preview
    /// may see an object at a pixel's edge that the first preview missed. These have no pixels.
    pub fn new<'a>(
        preview: &'a PreviewResult,
        more: impl IntoIterator<Item = &'a protocol::Stratum>,
    ) -> Self {
        let records: Vec<&[u32]> = preview.frames.iter().map(|frame| &frame.cache_records[..]).collect();
        Self::with_records(preview, more, &records)
    }

    /// The same with other numbers of records, by frame and level.
    pub fn with_records<'a>(
        preview: &'a PreviewResult,
        more: impl IntoIterator<Item = &'a protocol::Stratum>,
        records: &[&[u32]],
    ) -> Self {
        let mut index = BTreeMap::new();
        let mut strata: Vec<Stratum> = Vec::with_capacity(preview.strata.len() + 1);
        let mut names = Vec::with_capacity(preview.strata.len());
        for stratum in preview.strata.iter().chain(more) {
            index.entry(stratum.identity()).or_insert_with(|| {
                let protocol::Stratum { object, material, prior_cost, .. } = *stratum;
                names.push(stratum.name.clone());
                strata.push(Stratum { object, material, prior_cost, apart: false });
                strata.len() - 1
            });
        }
        let background = strata.len();
        strata.push(Stratum::background(preview.background_prior_cost));
        let mut frames: Vec<FramePopulation> = preview
            .frames
            .iter()
            .map(|frame| {
                let mut counts = vec![0; strata.len()];
                counts[..frame.pixels.len()].copy_from_slice(&frame.pixels);
                counts[background] = frame.background;
                FramePopulation {
                    number: i64::from(frame.frame),
                    counts,
                    lights: frame.lights,
                    shining: frame.shining,
                    triangles: frame.triangles,
                }
            })
            .collect();
        let prior_cost = preview.record_prior_cost.unwrap_or(1.0);
        let records = RecordStrata::add(&mut strata, &mut frames, records, prior_cost);
        Self { strata, frames, names, index, background, records }
    }

    /// The stratum that a profiled pixel shows.
    pub fn shown_by(&self, sample: &protocol::ProfileSample, profile: &protocol::ProfileResult) -> usize {
        let known = profile.strata.get(sample.stratum as usize);
        known.and_then(|stratum| self.index.get(&stratum.identity())).copied().unwrap_or(self.background)
    }
}

fn not_chosen(error: ForecastError) -> AdvanceError {
    AdvanceError::Hopeless(format!("no frames could be chosen to be profiled: {error}"))
}

/// More frames to profile, ascending, beside those that these profiles are of; nothing if these say enough, or if more would take too much.
pub(super) fn more_to_profile(
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
) -> Result<Vec<u32>, AdvanceError> {
    let Estimated { shot, populations } = estimated(preview, profiles, None)?;
    let spent = profiles.iter().map(|profile| profile.result.work_on_pixels()).fold(0, u64::saturating_add);
    let more =
        choose_more_frames(&populations.strata, &populations.frames, &shot, spent).map_err(not_chosen)?;
    Ok(more.into_iter().map(|index| preview.frames[index].frame).collect())
}

/// The frames to profile first, ascending.
pub(super) fn frames_to_profile(
    preview: &PreviewResult,
    at_most: Option<u32>,
) -> Result<Vec<u32>, AdvanceError> {
    let populations = Populations::new(preview, []);
    let at_most = at_most.map_or(FIRST_FRAMES, |at_most| at_most as usize);
    let chosen = choose_frames(&populations.strata, &populations.frames, at_most).map_err(not_chosen)?;
    if chosen.is_empty() {
        return Err(AdvanceError::Hopeless("no frame was chosen to be profiled".to_owned()));
    }
    Ok(chosen.into_iter().map(|index| preview.frames[index].frame).collect())
}
