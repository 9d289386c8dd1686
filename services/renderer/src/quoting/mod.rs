//! What a quote needs of a shot: what every frame shows, and what cheap parts of a few frames cost.
//!
//! | file | subject |
//! | --- | --- |
//! | `previews` | what frames show, as the wire has it |
//! | `probes` | which parts of a frame are measured, by what the renderer can do |
//! | `pixels` | profiles of single pixels, if the renderer can measure them |
//! | `coverage` | what pixels cost that share values of indirect light |
//! | `neighbours` | blocks of neighbours, whose time is that of a render |
//! | `offline` | a quote on this machine alone |

mod coverage;
mod neighbours;
mod offline;
mod pixels;
mod previews;
mod probes;

pub use neighbours::{WARMING_SHARE, free_neighbours, middle_mean, proportional_sites, sites};
pub use offline::{QuotingError, QuotingStep, ShotQuote, Wanted, quote_shot};
pub use pixels::{PixelChoice, PixelProfile, profile_pixels};
pub(crate) use previews::own_number;
pub use previews::preview_result;

use crate::door::{
    Artefact, BlockCosts, Capability, Cost, FixedCosts, Part, RendererError, RendererId, Run, Settings, Shot,
    Stopping,
};
use forelight_protocol::{FixedPart, MeasuredFrame, MeasuredShare, Spent, StratumTime, Varied};
use image::RgbImage;
use probes::{best, costs, hide, probes, whole};
use std::collections::BTreeMap;

/// A measured frame, and what a render takes over of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Its costs. Its shares have no hashes yet.
    pub result: MeasuredFrame,
    /// The files of these shares, in the same order.
    pub artefacts: Vec<Artefact>,
    /// Where in the image the time of the largest measured part went, if the renderer says so.
    pub blocks: Option<BlockCosts>,
    /// Object and material of each pixel as a colour, if the renderer made such a picture.
    pub ids: Option<RgbImage>,
}

/// Whether a quote at these settings knows where in the image the time will go: see [`ShotQuote::pixel_costs`].
pub fn locates_costs(shot: &dyn Shot, settings: &Settings) -> bool {
    let can = shot.capabilities(settings);
    can.contains(&Capability::MeasurePixels)
        || can.contains(&Capability::LocateCosts) && best(&can, settings) == Varied::Samples
}

/// Measures parts of a frame, by what the renderer can do: a few samples, or smaller images, or regions. If
/// it can do none of these, the whole frame is measured. `turn` is the number of frames that are measured
/// before this one.
///
/// # Errors
/// If the renderer fails or the run is stopped.
pub fn measure_frame(
    renderer: &RendererId,
    shot: &dyn Shot,
    (frame, turn): (u32, u32),
    settings: &Settings,
    run: &Run<'_>,
) -> Result<Measurement, RendererError> {
    let number = own_number(frame)?;
    let can = shot.capabilities(settings);
    let varied = best(&can, settings);
    let (mut measured, mut shares, mut artefacts) = (Vec::new(), Vec::new(), Vec::new());
    let (mut times, mut spent) = (BTreeMap::new(), Cost::default());
    let mut known_fixed: Vec<FixedCosts> = Vec::new();
    let (mut blocks, mut ids) = (None, None);
    let mut whole = whole(varied, settings);
    let mut stops_at = None;
    let mut done = 0;
    while let Some(probe) = probes(varied, &can, settings, whole, turn).into_iter().nth(done) {
        done += 1;
        if probe.in_addition && !hide(&measured) {
            continue;
        }
        let part = shot.measure(number, &probe.settings, &probe.part, run)?;
        spent += &part.cost;
        if let Some(Stopping { samples, cost }) = &part.stopping {
            // Of so many samples, fewer are a small share.
            whole = (samples.round() as u32).clamp(1, whole);
            stops_at = Some(*samples);
            spent += cost;
        }
        measured.extend(costs(varied, &probe, &part));
        let cpu_nanos = part.sample_nanos();
        if let (Some(artefact), Part::Samples { offset, count }) = (part.artefact, &probe.part) {
            shares.push(MeasuredShare { offset: *offset, count: *count, cpu_nanos, hash: None });
            artefacts.push(artefact);
        }
        blocks = part.blocks.or(blocks);
        ids = ids.or(part.ids);
        known_fixed.extend(Some(part.fixed).filter(|fixed| !fixed.is_empty()));
        for cost in part.strata {
            *times.entry((cost.count.object, cost.count.material)).or_insert(0) += cost.nanos;
        }
    }
    if let Some(samples) = stops_at {
        // Each frame has its own number of samples, so all are measured in parts of a frame.
        measured.iter_mut().for_each(|cost| cost.amount = in_parts(cost.amount, samples));
        whole = PARTS;
    }
    let time = |((object, material), nanos)| StratumTime { object, material, nanos };
    let result = MeasuredFrame {
        frame,
        renderer: renderer.clone(),
        varied,
        whole,
        costs: measured,
        fixed: mean(&known_fixed),
        strata: times.into_iter().map(time).collect(),
        shares,
        preview_png: None,
        spent: Spent::uncounted(spent.cpu_nanos),
        peak_memory_bytes: spent.peak_memory_bytes,
    };
    Ok(Measurement { result, artefacts, blocks, ids })
}

/// Parts of a frame whose pixels stop by their noise.
const PARTS: u32 = 1_000_000;

/// So many samples in parts of a frame that has `whole`.
fn in_parts(samples: u32, whole: f64) -> u32 {
    (f64::from(samples) * f64::from(PARTS) / whole.max(1.0)).round() as u32
}

/// The mean of fixed costs, by name. What is absent from one of them is 0 there.
fn mean(all: &[FixedCosts]) -> Vec<FixedPart> {
    let mut sums = FixedCosts::new();
    for (name, nanos) in all.iter().flatten() {
        *sums.entry(name.clone()).or_insert(0) += nanos;
    }
    let cost = |(name, sum)| FixedPart { name, cpu_nanos: sum / all.len().max(1) as u64 };
    sums.into_iter().map(cost).collect()
}
