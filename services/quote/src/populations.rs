//! A preview in the terms of the statistics: strata, and how many pixels of each stratum every frame shows.

use std::collections::BTreeMap;

use forelight_forecast::{FramePopulation, RecordStrata, Strategy, Stratum};
use forelight_protocol::{self as protocol, PreviewResult, StratumName};

/// Strata and frames of a shot. The strata of pixels come first, in the order of the preview, with the background as the
/// last of them. The strata of the irradiance cache's records follow.
///
/// Workers join small strata by material, pixel count and prior cost before they choose pixels. An estimate that joined
/// other strata would be biased. So objects, materials, prior costs and their order are those that workers report.
#[derive(Clone, Debug)]
pub(crate) struct Populations {
    /// What the strategy tells apart, then the records.
    pub strata: Vec<Stratum>,
    /// Every frame's pixels and records by stratum.
    pub frames: Vec<FramePopulation>,
    /// Names of the strata of pixels, without the background.
    pub names: Vec<StratumName>,
    /// Place in `names` by object and material.
    index: BTreeMap<(u32, u32), usize>,
    /// For each name and the background: the stratum that the strategy puts it into.
    places: Vec<u32>,
    /// Where the strata of records are.
    pub records: RecordStrata,
    /// How many strata of pixels there are.
    pub pixel_strata: usize,
}

impl Populations {
    /// The strata of the preview and those of `more`. A profile may see an object at the edge of a pixel where the preview
    /// saw another one, if a GPU made the preview and a CPU the profile. Such strata have no pixels.
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

    /// The stratum of a profiled pixel.
    pub fn stratum_of(&self, sample: &protocol::ProfileSample, profile: &protocol::ProfileResult) -> u32 {
        let shown = profile.strata.get(sample.stratum as usize);
        let place = shown.and_then(|stratum| self.index.get(&stratum.identity()));
        self.places[place.copied().unwrap_or(self.names.len())]
    }
}
