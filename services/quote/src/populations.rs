//! Turns a preview into strata, and counts the pixels of each stratum in every frame.

use std::collections::BTreeMap;

use forelight_forecast::{FramePopulation, RecordStrata, Strategy, Stratum};
use forelight_protocol::{self as protocol, PreviewResult, StratumName};

/// Strata and frames of a shot: first the pixels' strata in the order of the preview, then the background,
/// then the strata of cache records.
///
/// Workers merge small strata by material, pixel count and prior cost before they choose pixels. The estimate
/// is unbiased only if it merges the same strata. So objects, materials, prior costs and their order are as
/// workers report them.
#[derive(Clone, Debug)]
pub(crate) struct Populations {
    /// Strata of the strategy, then those of records.
    pub strata: Vec<Stratum>,
    pub frames: Vec<FramePopulation>,
    /// Names of the pixels' strata, without the background.
    pub names: Vec<StratumName>,
    /// Index into `names` by object and material.
    index: BTreeMap<(u32, u32), usize>,
    /// Stratum of each name, and of the background.
    places: Vec<u32>,
    pub records: RecordStrata,
    pub pixel_strata: usize,
}

impl Populations {
    /// Strata of the preview and those of `more`. At edges, a profile on a CPU may show objects that a
    /// preview on a GPU does not. Their strata have no pixels.
    pub fn new<'a>(
        preview: &'a PreviewResult,
        more: impl IntoIterator<Item = &'a protocol::Stratum>,
        strategy: Strategy,
        records: &[&[u32]],
    ) -> Self {
        let mut index = BTreeMap::new();
        let mut shown: Vec<Stratum> = Vec::with_capacity(preview.strata.len() + 1);
        let mut names = Vec::with_capacity(preview.strata.len());
        for stratum in preview.strata.iter().chain(more) {
            index.entry(stratum.identity()).or_insert_with(|| {
                let protocol::Stratum { object, material, prior_cost, .. } = *stratum;
                names.push(stratum.name.clone());
                shown.push(Stratum { object, material, prior_cost, apart: false });
                shown.len() - 1
            });
        }
        shown.push(Stratum::background(preview.background_prior_cost));
        let classes = strategy.classes(&shown);
        let mut strata = classes.strata.clone();
        let pixel_strata = strata.len();
        let mut frames: Vec<FramePopulation> = preview
            .frames
            .iter()
            .map(|frame| {
                let mut counts = vec![0; shown.len()];
                counts[..frame.pixels.len()].copy_from_slice(&frame.pixels);
                counts[names.len()] = frame.background;
                FramePopulation {
                    number: i64::from(frame.frame),
                    counts: classes.counts(&counts),
                    lights: frame.lights,
                    shining: frame.shining,
                    triangles: frame.triangles,
                }
            })
            .collect();
        let prior_cost = preview.record_prior_cost.unwrap_or(1.0);
        let records = RecordStrata::add(&mut strata, &mut frames, records, prior_cost);
        Self { strata, frames, names, index, places: classes.of, records, pixel_strata }
    }

    /// For each frame, the number for its set of shining lights. Empty if all frames have the same.
    pub fn lights(frames: &[FramePopulation]) -> Vec<u32> {
        let lights: Vec<u32> = frames.iter().map(|frame| frame.lights).collect();
        if lights.windows(2).all(|pair| pair[0] == pair[1]) { Vec::new() } else { lights }
    }

    pub fn stratum_of(&self, sample: &protocol::ProfileSample, profile: &protocol::ProfileResult) -> u32 {
        let shown = profile.strata.get(sample.stratum as usize);
        let place = shown.and_then(|stratum| self.index.get(&stratum.identity()));
        self.places[place.copied().unwrap_or(self.names.len())]
    }
}
