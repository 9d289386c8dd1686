//! From a preview to the frames that are worth profiling.

use std::collections::BTreeMap;

use forelight_forecast::{FramePopulation, Stratum, choose_frames};
use forelight_protocol::{PreviewResult, StratumName};

use super::AdvanceError;

/// What a pixel that shows nothing costs, beside one that shows a surface.
const BACKGROUND_COST: f64 = 0.1;

/// A preview as the forecast wants it: strata by number, the background as the last of them.
pub(super) struct Populations {
    pub strata: Vec<Stratum>,
    pub frames: Vec<FramePopulation>,
    /// Number of each named stratum.
    pub index: BTreeMap<StratumName, usize>,
}

impl Populations {
    /// Numbers the strata of a preview and then those of `more` that it does not have: a profile made on another
    /// kind of preview may see an object at a pixel's edge that the first preview missed. These have no pixels.
    pub fn new<'a>(preview: &'a PreviewResult, more: impl IntoIterator<Item = &'a StratumName>) -> Self {
        let mut index = BTreeMap::new();
        let mut names = Vec::new();
        for name in preview.strata.iter().chain(more) {
            index.entry(name.clone()).or_insert_with(|| {
                names.push(name);
                names.len() - 1
            });
        }
        let mut objects = Numbers::default();
        let mut materials = Numbers::default();
        let mut strata: Vec<Stratum> = names
            .iter()
            .map(|name| Stratum {
                object: objects.of(&name.object),
                material: materials.of(&name.material),
                prior_cost: 1.0,
            })
            .collect();
        strata.push(Stratum { object: u32::MAX, material: u32::MAX, prior_cost: BACKGROUND_COST });
        let frames = preview
            .frames
            .iter()
            .map(|frame| {
                let mut counts = vec![0; strata.len()];
                counts[..frame.pixels.len()].copy_from_slice(&frame.pixels);
                counts[names.len()] = frame.background;
                FramePopulation { number: i64::from(frame.frame), counts }
            })
            .collect();
        Self { strata, frames, index }
    }

    /// The number of the background's stratum.
    pub fn background(&self) -> usize {
        self.strata.len() - 1
    }
}

/// Numbers for names, in the order in which they come.
#[derive(Default)]
struct Numbers<'a>(BTreeMap<&'a str, u32>);

impl<'a> Numbers<'a> {
    fn of(&mut self, name: &'a str) -> u32 {
        let next = self.0.len() as u32;
        *self.0.entry(name).or_insert(next)
    }
}

/// The frames to profile, ascending.
pub(super) fn frames_to_profile(preview: &PreviewResult, at_most: u32) -> Result<Vec<u32>, AdvanceError> {
    let populations = Populations::new(preview, []);
    let chosen =
        choose_frames(&populations.strata, &populations.frames, at_most as usize).map_err(|error| {
            AdvanceError::Hopeless(format!("no frames could be chosen to be profiled: {error}"))
        })?;
    if chosen.is_empty() {
        return Err(AdvanceError::Hopeless("no frame was chosen to be profiled".to_owned()));
    }
    Ok(chosen.into_iter().map(|index| preview.frames[index].frame).collect())
}
